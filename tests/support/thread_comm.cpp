#include "tests/support/thread_comm.hpp"

#include <algorithm>
#include <chrono>
#include <cstring>
#include <string>
#include <thread>

#include "common/base/check.hpp"

namespace rcb::testing {
namespace {

constexpr std::chrono::seconds kMeetingLimit{60};

void copy(std::span<const std::byte> from, std::span<std::byte> to) {
  RCB_CHECK(from.size() == to.size(), "both sides know the size");
  if (!from.empty()) std::memcpy(to.data(), from.data(), from.size());
}

}  // namespace

ThreadWorld::ThreadWorld(int ranks) : calls_(static_cast<std::size_t>(ranks)) {}

void ThreadWorld::meet() {
  std::unique_lock lock(mutex_);
  if (++here_ == ranks()) {
    here_ = 0;
    ++meeting_;
    met_.notify_all();
    return;
  }
  const std::uint64_t meeting = meeting_;
  RCB_CHECK(met_.wait_for(lock, kMeetingLimit, [&] { return meeting_ != meeting; }),
            "a rank did not come to a collective");
}

void ThreadComm::enter(const ThreadWorld::Call& call) {
  world_.calls_[static_cast<std::size_t>(rank_)] = call;
  world_.meet();
  for (const ThreadWorld::Call& other : world_.calls_)
    RCB_CHECK(std::strcmp(other.name, call.name) == 0 && other.root == call.root,
              std::string("ranks call different collectives: ") + call.name + " and " + other.name);
}

template <typename Combine>
void ThreadComm::reduce(const char* name, std::span<std::uint64_t> values, const Combine& combine) {
  enter({name, 0, std::as_bytes(values), {}});
  std::vector<std::uint64_t> result(values.begin(), values.end());
  for (int r = 0; r < size(); ++r) {
    if (r == rank_) continue;
    const std::span<const std::byte> other = call_of(r).bytes;
    RCB_CHECK(other.size() == values.size_bytes(), "ranks reduce arrays of different lengths");
    for (std::size_t i = 0; i < result.size(); ++i) {
      std::uint64_t value = 0;
      std::memcpy(&value, other.data() + i * sizeof(value), sizeof(value));
      result[i] = combine(result[i], value);
    }
  }
  world_.meet();
  std::ranges::copy(result, values.begin());
}

void ThreadComm::all_sum(std::span<std::uint64_t> values) {
  reduce("all_sum", values, [](std::uint64_t a, std::uint64_t b) { return a + b; });
}
void ThreadComm::all_min(std::span<std::uint64_t> values) {
  reduce("all_min", values, [](std::uint64_t a, std::uint64_t b) { return std::min(a, b); });
}
void ThreadComm::all_max(std::span<std::uint64_t> values) {
  reduce("all_max", values, [](std::uint64_t a, std::uint64_t b) { return std::max(a, b); });
}

void ThreadComm::collect(Buffer<std::byte>& all, std::vector<std::size_t>& sizes) const {
  for (int r = 0; r < size(); ++r) {
    const std::span<const std::byte> bytes = call_of(r).bytes;
    all.append(bytes);
    sizes.push_back(bytes.size());
  }
}

void ThreadComm::all_gather(std::span<const std::byte> local, Buffer<std::byte>& all, std::vector<std::size_t>& sizes) {
  all.clear();
  sizes.clear();
  enter({"all_gather", 0, local, {}});
  collect(all, sizes);
  world_.meet();
}

void ThreadComm::gather(std::span<const std::byte> local, int root, Buffer<std::byte>& all,
                        std::vector<std::size_t>& sizes) {
  all.clear();
  sizes.clear();
  enter({"gather", root, local, {}});
  if (rank_ == root) collect(all, sizes);
  world_.meet();
}

void ThreadComm::broadcast(std::span<std::byte> bytes, int root) {
  enter({"broadcast", root, bytes, {}});
  if (rank_ != root) copy(call_of(root).bytes, bytes);
  world_.meet();
}

void ThreadComm::exchange(std::span<const std::span<const std::byte>> send,
                          std::span<const std::span<std::byte>> receive) {
  const auto ranks = static_cast<std::size_t>(size());
  RCB_CHECK(send.size() == ranks && receive.size() == ranks, "one piece a rank");
  enter({"exchange", 0, {}, send});
  for (int r = 0; r < size(); ++r)
    copy(call_of(r).pieces[static_cast<std::size_t>(rank_)], receive[static_cast<std::size_t>(r)]);
  world_.meet();
}

void ThreadComm::barrier() {
  enter({"barrier", 0, {}, {}});
  world_.meet();
}

void run_threads(int ranks, const std::function<void(int)>& body) {
  std::vector<std::thread> threads;
  for (int r = 1; r < ranks; ++r)
    threads.emplace_back([&body, r, ranks] {
      set_check_context("rank " + std::to_string(r) + " of " + std::to_string(ranks));
      body(r);
    });
  body(0);
  for (std::thread& thread : threads) thread.join();
}

}  // namespace rcb::testing
