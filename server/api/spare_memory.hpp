// SpareMemory: of each scene the memory of its last push, for the next one: a step touches no fresh pages. Any thread.
#pragma once

#include <cstddef>
#include <map>
#include <mutex>
#include <string>
#include <utility>
#include <vector>

#include "common/base/buffer.hpp"

namespace rcb::api {

class SpareMemory {
 public:
  // Frees what was kept for the scene, and keeps these.
  void keep(const std::string& scene, std::vector<Buffer<std::byte>> buffers) {
    const std::lock_guard lock(mutex_);
    kept_[scene] = std::move(buffers);
  }
  void free(const std::string& scene) {
    const std::lock_guard lock(mutex_);
    kept_.erase(scene);
  }
  // One that was kept; an empty one if there is none.
  Buffer<std::byte> take(const std::string& scene) {
    const std::lock_guard lock(mutex_);
    const auto found = kept_.find(scene);
    if (found == kept_.end() || found->second.empty()) return {};
    Buffer<std::byte> buffer = std::move(found->second.back());
    found->second.pop_back();
    return buffer;
  }

 private:
  std::mutex mutex_;
  std::map<std::string, std::vector<Buffer<std::byte>>> kept_;
};

}  // namespace rcb::api
