// A partition that is given up ends on all ranks, whenever go_on says so.
#include <fmt/format.h>
#include <gtest/gtest.h>

#include "common/partition/partition.hpp"
#include "common/partition/quality/quality.hpp"
#include "tests/support/on_ranks.hpp"
#include "tests/support/scenes.hpp"

namespace rcb::partition {
namespace {

using namespace testing;

// Says no at its call number `last`, counted from 0. The barrier fails where ranks don't ask at the same time.
comm::GoOn until(comm::Comm& comm, int last, int& asked) {
  return [&comm, last, &asked] {
    comm.barrier();
    return asked++ < last;
  };
}

// run(go_on) returns whether it went through.
template <typename Run>
void give_up_at_each_call(comm::Comm& comm, const Run& run) {
  int all = 0;
  ASSERT_TRUE(run(until(comm, 1 << 20, all)));
  EXPECT_GE(all, 1);
  for (int last = 0; last < all; ++last) {
    int asked = 0;
    EXPECT_FALSE(run(until(comm, last, asked))) << "call " << last;
    EXPECT_EQ(asked, last + 1);
  }
}

TEST(GoOn, EveryMethodEndsAtEveryCall) {
  for (const Method method : {Method::rcb, Method::bands_x, Method::bands_z, Method::equal_boxes, Method::file_order})
    for (const Weights weights : {Weights::none, Weights::uniform})
      for (const bool sampled : {false, true}) {
        SCOPED_TRACE(
            fmt::format("{}, weights {}, sampled {}", method_name(method), static_cast<int>(weights), sampled));
        const Scene scene = make_scene(Shape::uniform, weights, 3, 3000, false, 20261129);
        PartitionOptions options;
        options.method = method;
        options.parts = 24;
        if (sampled) options.tuning.sample = {.count_min = 0, .per_part_min = 0, .stride = 8, .sample_min = 1};
        on_ranks([&](comm::Comm& comm) {
          const Share share = deal(scene, comm.rank(), comm.size(), 7);
          give_up_at_each_call(comm, [&](const comm::GoOn& go_on) {
            const Result<PartitionResult> found = partition(comm, share.particles.view(), options, go_on);
            EXPECT_TRUE(found.ok() || found.status().code() == Code::aborted);
            return found.ok();
          });
        });
      }
}

TEST(GoOn, QualityEndsAtEveryCall) {
  const Scene scene = make_scene(Shape::uniform, Weights::none, 3, 3000, false, 20261129);
  on_ranks([&](comm::Comm& comm) {
    const Share share = deal(scene, comm.rank(), comm.size(), 7);
    const std::vector<std::int32_t> part(share.row.size(), 1);
    give_up_at_each_call(comm, [&](const comm::GoOn& go_on) {
      return quality(comm, share.particles.view(), part, 3, nullptr, std::nullopt, go_on).has_value();
    });
  });
}

}  // namespace
}  // namespace rcb::partition
