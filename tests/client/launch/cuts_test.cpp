// What a client tells by the cuts is what the service says, over a real service: for positions on cuts and one bit
// beside them, too, with and without ids.
#include <algorithm>
#include <cmath>
#include <numeric>
#include <vector>

#include <gtest/gtest.h>

#include "client/launch/launch.hpp"
#include "client/lib/client.hpp"
#include "common/base/random.hpp"

namespace rcb::client {
namespace {

constexpr std::uint64_t kSeed = 90210;

// Half of the positions anywhere; of the others each coordinate is a cut's, or a bit off, or anywhere. So many share
// all coordinates with a cut's key.
std::vector<double> on_cuts(const cuts::CutTree& tree, std::size_t count, Random& random) {
  const auto dims = static_cast<std::size_t>(tree.dims);
  std::vector<double> rows(count * dims);
  for (double& value : rows) value = random.uniform();
  for (std::size_t i = 0; i < count; i += 2) {
    const cuts::Cut& cut = tree.cuts[random.below(tree.cuts.size())];
    const bool all = random.below(3) == 0;
    for (std::size_t a = 0; a < dims && !cut.right_empty; ++a) {
      const double at = cut.key.at[a];
      const std::uint64_t kind = all ? 0 : random.below(a == 0 ? 3 : 4);
      double& x = rows[i * dims + static_cast<std::size_t>(cut.axes[a])];
      if (kind == 0) x = at;
      if (kind == 1) x = std::nextafter(at, 2);
      if (kind == 2) x = std::nextafter(at, -1);
    }
  }
  return rows;
}

// By row, as the service says.
std::vector<std::int32_t> assigned(Client& client, const std::string& scene, std::span<const std::int64_t> ids) {
  const auto reply = client.call("assign", "{\"scene\":\"" + scene + "\"}");
  EXPECT_TRUE(reply.ok()) << reply.status().message();
  const auto id = reply->find("id")->i8();
  const auto part = reply->find("part")->i4();
  if (ids.empty()) return {part.begin(), part.end()};
  std::vector<std::int32_t> by_row;
  for (const std::int64_t one : ids)
    by_row.push_back(part[static_cast<std::size_t>(std::lower_bound(id.begin(), id.end(), one) - id.begin())]);
  return by_row;
}

std::size_t differences(std::span<const std::int32_t> a, std::span<const std::int32_t> b) {
  if (a.size() != b.size()) return std::max(a.size(), b.size());
  return static_cast<std::size_t>(
      std::inner_product(a.begin(), a.end(), b.begin(), 0, std::plus<>(), std::not_equal_to<>()));
}

void expect_tiles(const cuts::Cuts& cuts, const Positions& positions, std::span<const std::int32_t> parts) {
  const auto regions = cuts.regions();
  const auto dims = static_cast<std::size_t>(cuts.dims());
  for (std::size_t p = 0; p < regions.size(); ++p)
    for (std::size_t q = 0; q < p; ++q) {
      bool apart = false;
      for (std::size_t a = 0; a < dims; ++a)
        apart = apart || regions[p].lo[a] >= regions[q].hi[a] || regions[q].lo[a] >= regions[p].hi[a];
      EXPECT_TRUE(apart) << "parts " << q << " and " << p;
    }
  std::size_t outside = 0;
  for (std::size_t row = 0; row < positions.count; ++row) {
    const geometry::Point x = positions.point(row);
    const geometry::Box& region = regions[static_cast<std::size_t>(parts[row])];
    for (std::size_t a = 0; a < dims; ++a) outside += x[a] < region.lo[a] || x[a] > region.hi[a] ? 1U : 0U;
  }
  EXPECT_EQ(outside, 0U);
}

struct CutsCase {
  int dims;
  std::size_t count;
  bool own_ids;
  Path path;
};

void check_owners(const std::string& endpoint, const CutsCase& of) {
  SCOPED_TRACE(::testing::Message() << of.dims << "D, seed " << kSeed << (of.own_ids ? ", ids" : ""));
  Random random(kSeed);
  auto client = Client::connect({.endpoint = endpoint, .path = of.path});
  ASSERT_TRUE(client.ok());
  ASSERT_TRUE(client->create_scene("cut", {.parts = 24, .dims = of.dims, .tolerance = INFINITY, .replace = true}).ok());
  auto scene = client->open_scene("cut");
  ASSERT_TRUE(scene.ok());
  std::vector<std::int64_t> ids;
  for (std::size_t i = 0; of.own_ids && i < of.count; ++i) ids.push_back(static_cast<std::int64_t>(3 * i + 2));
  for (std::size_t i = ids.size(); i > 1; --i) std::swap(ids[i - 1], ids[random.below(i)]);
  std::vector<double> xyz(of.count * static_cast<std::size_t>(of.dims));
  for (double& value : xyz) value = random.uniform();
  ASSERT_TRUE(scene->step(Positions::rows(xyz.data(), of.count, of.dims), {.ids = ids}).ok());
  std::vector<std::int32_t> before(of.count, -1);  // told last
  for (int step = 1; step < 4; ++step) {
    if (step == 3) {  // by another client, so to speak
      ASSERT_TRUE(client->call("rebalance", R"({"scene":"cut","parts":11,"force":true})").ok());
    }
    const auto known = scene->cuts();
    ASSERT_TRUE(known.ok()) << known.status().message();
    EXPECT_EQ(known->epoch(), 1U) << "those of the step that was answered";
    const auto moved = on_cuts(known->tree(), of.count, random);
    const Positions positions = Positions::rows(moved.data(), of.count, of.dims);
    const auto done = scene->step(positions, {.ids = ids, .want_parts = true, .want_changes = true, .threads = step});
    ASSERT_TRUE(done.ok()) << done.status().message();
    const auto parts = assigned(*client, "cut", ids);
    EXPECT_EQ(differences(done->parts, parts), 0U);
    const auto cuts = scene->cuts();
    EXPECT_EQ(cuts->epoch(), done->report.epoch);
    EXPECT_EQ(cuts->parts(), step == 3 ? 11 : 24);
    std::vector<std::int32_t> owners(of.count);
    ASSERT_TRUE(cuts->owner(positions, {.ids = ids}, owners).ok());
    EXPECT_EQ(differences(owners, parts), 0U);
    for (const PartChange& change : done->changes) before[change.row] = change.part;
    EXPECT_EQ(differences(before, parts), 0U);
    expect_tiles(*cuts, positions, parts);
  }
}

TEST(Cuts, OwnersAreThoseThatTheServiceAssigns) {
  auto service = launch::Embedded::start(3, [](double) {});
  ASSERT_TRUE(service.ok()) << service.status().message();
  for (const bool own_ids : {false, true}) {
    check_owners(service->endpoint(), {3, 1'000'000, own_ids, Path::shared});
    check_owners(service->endpoint(), {2, 50'000, own_ids, Path::direct});
    check_owners(service->endpoint(), {1, 50'000, own_ids, Path::gateway});
  }
}

}  // namespace
}  // namespace rcb::client
