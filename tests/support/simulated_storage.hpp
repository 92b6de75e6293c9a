// SimulatedStorage: a file system in memory that fails calls from a seed, has as much room as a test gives it, and on
// which a process dies: the call (or copy) at which it does is done, half done or not done, and ProcessDied is thrown.
// What was stored until then is what the next process finds; what the process still calls is not done. Any thread may
// call.
#pragma once

#include <algorithm>
#include <exception>
#include <limits>
#include <map>
#include <memory>
#include <mutex>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "common/base/random.hpp"
#include "server/scene/storage.hpp"

namespace rcb::testing {

struct ProcessDied : std::exception {};  // which ends no side thread

class SimulatedStorage final : public scene::Storage {
 public:
  explicit SimulatedStorage(std::uint64_t seed) : random_(seed) {}

  double fault_rate = 0;                                       // of all calls that may fail
  std::size_t room = std::numeric_limits<std::size_t>::max();  // bytes of all files together
  // The process dies in the call or copy after so many more.
  void die_after(std::uint64_t calls) { calls_left_ = calls; }
  void live() {
    calls_left_ = kForever;
    due_ = dead_ = false;
  }
  // What is stored, by path, for tests to look at and to damage.
  std::map<std::string, std::shared_ptr<std::string>> files;

  Status make_folder(const std::string& path) override {
    const std::lock_guard lock(one_.mutex);
    if (fails()) return fault("make", path);
    if (dies() && coin()) die();
    for (std::size_t end = path.find('/', 1);; end = path.find('/', end + 1)) {
      folders_.insert(path.substr(0, end));
      if (end == std::string::npos) break;
    }
    return die_if_due();
  }
  Result<std::vector<std::string>> names_in(const std::string& folder) const override {
    const std::lock_guard lock(one_.mutex);
    if (fails()) return fault("look into", folder);
    std::vector<std::string> names;
    const std::string prefix = folder + "/";
    const auto add = [&](const std::string& path) {
      if (path.starts_with(prefix) && path.find('/', prefix.size()) == std::string::npos)
        names.push_back(path.substr(prefix.size()));
    };
    for (const auto& [path, bytes] : files) add(path);
    for (const std::string& path : folders_) add(path);
    return names;
  }
  Result<std::unique_ptr<scene::MappedFile>> make_file(const std::string& path, std::size_t bytes) override {
    const std::lock_guard lock(one_.mutex);
    if (dead_) die();
    files.erase(path);
    if (fails() || bytes > room || used() > room - bytes) return fault("make", path);
    if (dies()) {  // anywhere between the file's making and its allocation
      if (coin()) files[path] = std::make_shared<std::string>(random_.below(bytes + 1), '\0');
      die();
    }
    files[path] = std::make_shared<std::string>(bytes, '\0');
    return std::unique_ptr<scene::MappedFile>(std::make_unique<File>(*this, files[path]));
  }
  Result<std::unique_ptr<scene::MappedFile>> open_file(const std::string& path, Access) const override {
    const std::lock_guard lock(one_.mutex);
    if (fails()) return fault("open", path);
    const auto found = files.find(path);
    if (found == files.end()) return Status(Code::not_found, path + " is not there");
    return std::unique_ptr<scene::MappedFile>(std::make_unique<File>(*this, found->second));
  }
  Status rename(const std::string& from, const std::string& to) override {
    const std::lock_guard lock(one_.mutex);
    if (fails()) return fault("rename", from);
    if (dies() && coin()) die();
    if (const auto file = files.extract(from)) {
      files[to] = file.mapped();
    } else {
      move_folder(from, to);
    }
    return die_if_due();
  }
  Status remove(const std::string& path) override {
    const std::lock_guard lock(one_.mutex);
    if (fails()) return fault("remove", path);
    if (dies() && coin()) die();
    files.erase(path);
    folders_.erase(path);
    return die_if_due();
  }

 private:
  using Content = std::shared_ptr<std::string>;
  // Copies are used by other threads.
  struct OneAtATime {
    OneAtATime() = default;
    OneAtATime(const OneAtATime&) {}
    std::mutex mutex;
  };
  static constexpr std::uint64_t kForever = std::numeric_limits<std::uint64_t>::max();

  class File final : public scene::MappedFile {
   public:
    File(const SimulatedStorage& disk, Content content) : disk_(disk), content_(std::move(content)) {}
    std::string_view bytes() const override { return *content_; }
    void store(std::size_t at, std::string_view bytes) override {
      const std::lock_guard lock(disk_.one_.mutex);
      RCB_CHECK(at <= content_->size() && bytes.size() <= content_->size() - at, "what is stored fits the file");
      if (!disk_.dies()) {
        content_->replace(at, bytes.size(), bytes);
        return;
      }
      // memcpy may copy from either end, and in words of any size.
      Random& random = disk_.random_;
      const std::size_t from = random.below(bytes.size() + 1);
      const std::uint64_t kind = random.below(4);
      const std::size_t word = std::size_t{1} << random.below(6);
      std::uint64_t taken = 0;
      for (std::size_t k = 0; k < bytes.size(); ++k) {
        if (k % word == 0) taken = random.below(2);
        if (kind == 0 ? k < from : kind == 1 ? k >= from : taken == 1) (*content_)[at + k] = bytes[k];
      }
      disk_.die();
    }

   private:
    const SimulatedStorage& disk_;
    Content content_;
  };

  bool coin() const { return random_.below(2) == 0; }
  bool fails() const { return fault_rate > 0 && random_.uniform() < fault_rate; }
  [[noreturn]] void die() const {
    dead_ = true;
    throw ProcessDied();
  }
  bool dies() const {
    if (dead_) die();
    if (calls_left_ == kForever) return false;
    if (calls_left_ > 0) --calls_left_;
    return due_ = calls_left_ == 0;
  }
  Status die_if_due() const {
    if (std::exchange(due_, false)) die();
    return {};
  }
  static Status fault(const char* what, const std::string& path) {
    return {Code::io_error, std::string("can't ") + what + " " + path + ": no space"};
  }
  std::size_t used() const {
    std::size_t sum = 0;
    for (const auto& [path, bytes] : files) sum += bytes->size();
    return sum;
  }
  void move_folder(const std::string& from, const std::string& to) {
    const auto moved = [&](const std::string& path) {
      return path == from || path.starts_with(from + "/") ? to + path.substr(from.size()) : path;
    };
    std::map<std::string, Content> all;
    for (auto& [path, bytes] : files) all[moved(path)] = bytes;
    files = std::move(all);
    std::set<std::string> folders;
    for (const std::string& path : folders_) folders.insert(moved(path));
    folders_ = std::move(folders);
  }

  mutable Random random_;
  mutable std::uint64_t calls_left_ = kForever;
  mutable bool due_ = false;
  mutable bool dead_ = false;
  mutable OneAtATime one_;
  std::set<std::string> folders_;
};

}  // namespace rcb::testing
