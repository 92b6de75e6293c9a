// Handing particles over: whatever the rounds and the width of slots, every particle is once on the rank of its part,
// in ascending id if many change; and what that takes stays within its bound.
#include "server/service/step/exchange.hpp"

#include <algorithm>
#include <atomic>
#include <mutex>
#include <numeric>

#include <gtest/gtest.h>
#include <malloc.h>

#include "common/base/random.hpp"
#include "common/layout/layout.hpp"
#include "tests/support/forwarding_comm.hpp"
#include "tests/support/on_ranks.hpp"

namespace rcb::testing {
namespace {

using namespace service;

double coordinate(particles::Id id, std::size_t axis) {
  return static_cast<double>(mix64(static_cast<std::uint64_t>(id) * 4 + axis) >> 12U);
}

// What part a particle has before (`turn` 0) and after; turn 1 changes the parts of every `few`-th alone.
std::int32_t part_of(particles::Id id, int turn, int parts, std::uint64_t few) {
  const auto value = static_cast<std::uint64_t>(id);
  if (turn == 1 && value % few != few - 1) turn = 0;
  return static_cast<std::int32_t>(mix64(value * 2 + static_cast<std::uint64_t>(turn)) %
                                   static_cast<std::uint64_t>(parts));
}

// This rank's share of n particles before anything is handed over.
Scene make_scene(const comm::Comm& comm, std::uint64_t n, int dims, int parts, bool weighted) {
  SceneOptions options;
  options.parts = parts;
  options.dims = dims;
  Scene scene = Scene::create("s", options);
  scene.particles.has_weights = weighted;
  scene.n = n;
  for (std::uint64_t i = 0; i < n; ++i) {
    const auto id = static_cast<particles::Id>(i * 3);
    const std::int32_t part = part_of(id, 0, parts, 1);
    if (layout::rank_of_part(part, parts, comm.size()) != comm.rank()) continue;
    scene.particles.id.push_back(id);
    scene.part.push_back(part);
    for (std::size_t a = 0; a < static_cast<std::size_t>(dims); ++a)
      scene.particles.position[a].push_back(coordinate(id, a));
    if (weighted) scene.particles.weight.push_back(coordinate(id, 3));
  }
  return scene;
}

// The particles get the parts that they have after. Returns the slots of those that leave.
std::vector<std::uint64_t> change_parts(const comm::Comm& comm, Scene& scene, std::uint64_t few) {
  std::vector<std::uint64_t> leaving;
  for (std::size_t i = 0; i < scene.part.size(); ++i) {
    scene.part[i] = part_of(scene.particles.id[i], 1, scene.options.parts, few);
    if (layout::rank_of_part(scene.part[i], scene.options.parts, comm.size()) != comm.rank()) leaving.push_back(i);
  }
  return leaving;
}

void expect_after(comm::Comm& comm, const Scene& scene, std::uint64_t few, bool full) {
  const std::size_t count = scene.particles.count();
  EXPECT_EQ(scene.part.size(), count);
  std::uint64_t wrong = 0;
  std::uint64_t held = count;
  std::uint64_t ids = 0;
  for (std::size_t i = 0; i < count; ++i) {
    const particles::Id id = scene.particles.id[i];
    ids += mix64(static_cast<std::uint64_t>(id));
    bool right = scene.part[i] == part_of(id, 1, scene.options.parts, few) &&
                 layout::rank_of_part(scene.part[i], scene.options.parts, comm.size()) == comm.rank();
    for (std::size_t a = 0; a < static_cast<std::size_t>(scene.options.dims); ++a)
      right = right && scene.particles.position[a][i] == coordinate(id, a);
    right = right && (!scene.particles.has_weights || scene.particles.weight[i] == coordinate(id, 3));
    wrong += right ? 0 : 1;
  }
  EXPECT_EQ(wrong, 0U);
  EXPECT_TRUE(!full || std::is_sorted(scene.particles.id.begin(), scene.particles.id.end()));
  std::uint64_t expected = 0;
  for (std::uint64_t i = 0; i < scene.n; ++i) expected += mix64(i * 3);
  comm.all_sum({&held, 1});
  comm.all_sum({&ids, 1});
  EXPECT_EQ(held, scene.n);
  EXPECT_EQ(ids, expected);
}

TEST(Exchange_, every_way_ends_with_each_particle_on_the_rank_of_its_part) {
  const ExchangeLimits at_once;
  const ExchangeLimits rounds{0, 40};  // five positions, ten parts
  on_ranks([&](comm::Comm& comm) {
    for (const ExchangeLimits& limits : {at_once, rounds})
      for (const std::uint64_t few : {std::uint64_t{1}, std::uint64_t{40}})
        for (const int dims : {1, 3})
          for (const int parts : {2, 9}) {  // 2: ranks without a part
            Scene scene = make_scene(comm, 700, dims, parts, dims == 1);
            change_parts(comm, scene, few);
            const std::uint64_t changed = send_strangers(comm, scene, false, limits);
            expect_after(comm, scene, few, changed > 0 && is_full_change(changed, scene.n));
          }
  });
}

TEST(Exchange_, those_that_are_known_to_leave_go) {
  on_ranks([](comm::Comm& comm) {
    const auto ranks = static_cast<std::size_t>(comm.size());
    for (const std::uint64_t few : {std::uint64_t{1}, std::uint64_t{40}})
      for (const bool known : {false, true}) {
        Scene exported = make_scene(comm, 700, 2, 9, true);
        std::vector<std::uint64_t> from_to(known ? ranks * ranks : 0);
        const std::vector<std::uint64_t> slots = change_parts(comm, exported, few);
        std::uint64_t leaving = slots.size();
        for (const std::uint64_t slot : slots)
          if (known)
            ++from_to[static_cast<std::size_t>(comm.rank()) * ranks +
                      static_cast<std::size_t>(layout::rank_of_part(exported.part[slot], 9, comm.size()))];
        comm.all_sum(from_to);
        comm.all_sum({&leaving, 1});
        if (leaving > 0) send_exports(comm, exported, slots, leaving, from_to);
        expect_after(comm, exported, few, leaving > 0 && is_full_change(leaving, 700));
      }
  });
}

TEST(Exchange_, a_first_partition_that_moves_nothing_still_sorts) {
  on_ranks([](comm::Comm& comm) {
    Scene scene = make_scene(comm, 500, 2, 8, false);
    std::reverse(scene.part.begin(), scene.part.end());
    std::reverse(scene.particles.id.begin(), scene.particles.id.end());
    for (std::size_t a = 0; a < 2; ++a)
      std::reverse(scene.particles.position[a].begin(), scene.particles.position[a].end());
    change_parts(comm, scene, 1U << 30U);
    EXPECT_EQ(send_strangers(comm, scene, true), 0U);
    expect_after(comm, scene, 1U << 30U, true);
  });
}

// The bytes that the whole process has from its heap.
std::uint64_t allocated() {
  const auto info = ::mallinfo2();
  return info.uordblks + info.hblkhd;
}

// Looks at the heap wherever ranks meet.
class WatchingComm final : public ForwardingComm {
 public:
  WatchingComm(comm::Comm& comm, std::atomic<std::uint64_t>& most) : ForwardingComm(comm), most_(most) {}

 private:
  void before() override {
    comm_.barrier();  // all ranks have what they will hold meanwhile
    const std::uint64_t now = allocated();
    std::uint64_t seen = most_;
    while (seen < now && !most_.compare_exchange_weak(seen, now)) {
    }
    comm_.barrier();  // and keep it until all have looked
  }

  std::atomic<std::uint64_t>& most_;
};

TEST(Exchange_, its_memory_is_bounded) {
  if (!ranks_are_threads()) GTEST_SKIP() << "the ranks' heaps are apart";
  if (allocated() == 0) GTEST_SKIP() << "this allocator doesn't tell";
  constexpr std::uint64_t kCount = 400'000;
  constexpr ExchangeLimits kLimits{0, 64 * 1024};
  for (const int ranks : {1, 2, 4})
    on_ranks({ranks}, [&](comm::Comm& comm) {
      static std::atomic<std::uint64_t> most;
      Scene scene = make_scene(comm, kCount, 3, 8, false);
      const std::vector<std::uint64_t> slots = change_parts(comm, scene, 1);
      std::vector<std::uint64_t> to(static_cast<std::size_t>(ranks)), from(to.size());
      for (const std::uint64_t slot : slots)
        ++to[static_cast<std::size_t>(layout::rank_of_part(scene.part[slot], 8, ranks))];
      comm::exchange_counts(comm, to, from);
      for (auto& axis : scene.particles.position) axis.shrink();
      scene.particles.id.shrink();
      scene.part.shrink();
      const std::uint64_t before = scene.particles.count();
      const std::uint64_t leaves = slots.size();
      const std::uint64_t arrives = std::accumulate(from.begin(), from.end(), std::uint64_t{0});
      // Invariant 3 of exchange.hpp, the list of those that leave as it grows, and some kilobytes of the comm's own.
      std::uint64_t bound =
          16 * std::max(before, before - leaves + arrives) + 8 * arrives + 8 * leaves + kLimits.round_bytes + 64 * 1024;
      bound += 36 * (arrives > leaves ? arrives - leaves : 0) + 24 * leaves;
      comm.all_sum({&bound, 1});
      comm.barrier();
      const std::uint64_t start = allocated();
      most = start;
      comm.barrier();
      WatchingComm watching(comm, most);
      send_strangers(watching, scene, true, kLimits);
      expect_after(comm, scene, 1, true);
      EXPECT_LE(most - start, bound) << comm.size() << " ranks";
      comm.barrier();
    });
}

}  // namespace
}  // namespace rcb::testing
