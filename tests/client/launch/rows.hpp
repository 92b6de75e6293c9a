// A solver's arrays by row, and what it believes of them.
#pragma once

#include <algorithm>
#include <map>
#include <tuple>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "client/lib/client.hpp"
#include "common/base/random.hpp"

namespace rcb::client {

struct Rows {
  std::vector<double> xyz, weights;  // no weights: empty
  std::vector<std::int64_t> ids;
  std::vector<std::int32_t> parts;  // as told last
  std::int64_t next_id = 0;

  Positions positions() const { return Positions::rows(xyz.data(), ids.size(), 3); }

  void add(std::size_t count, Random& random, bool weighted) {
    for (; count > 0; --count) {
      ids.push_back(next_id++);
      for (int a = 0; a < 3; ++a) xyz.push_back(random.uniform());
      if (weighted) weights.push_back(random.uniform(0.5, 2));
    }
  }
  void move(Random& random, double most) {
    for (double& x : xyz) x += random.uniform(-most, most);
  }
  // Some go, up to `most` come, and the rows are in another order. options: gets how many.
  void change(Random& random, std::size_t most, StepOptions& options) {
    const bool weighted = !weights.empty();
    const std::size_t before = ids.size();
    for (std::size_t row = 0; row < ids.size();) {
      swap(row, row + random.below(ids.size() - row));
      if (random.below(25) != 0) {
        ++row;
        continue;
      }
      swap(row, ids.size() - 1);
      ids.pop_back();
      xyz.resize(3 * ids.size());
      weights.resize(weighted ? ids.size() : 0);
    }
    options.removed = before - ids.size();
    options.inserted = random.below(most + 1);
    add(options.inserted, random, weighted);
  }
  void note(const StepResult& result) {
    parts.resize(ids.size(), -1);
    for (const PartChange& change : result.changes) parts.at(change.row) = change.part;
  }
  // Expects the service to hold this. False: its ranks have lost the particles since the step.
  bool expect_held(Client& client, const std::string& scene) const {
    const auto reply = client.call("fetch", "{\"scene\":\"" + scene + "\"}");
    if (reply.status().code() == Code::not_found) return false;
    EXPECT_TRUE(reply.ok()) << reply.status().message();
    if (!reply) return false;
    const auto id = reply->find("id")->i8();
    const auto y = reply->find("y")->f8();
    const auto part = reply->find("part")->i4();
    const Array* w = reply->find("w");
    EXPECT_EQ(id.size(), ids.size());
    EXPECT_EQ(w != nullptr, !weights.empty());
    if (::testing::Test::HasFailure()) return true;
    std::map<std::int64_t, std::tuple<double, double, std::int32_t>> there;
    for (std::size_t i = 0; i < id.size(); ++i) there[id[i]] = {y[i], w == nullptr ? 0 : w->f8()[i], part[i]};
    std::size_t wrong = 0;
    for (std::size_t row = 0; row < ids.size(); ++row)
      wrong += there[ids[row]] == std::tuple(xyz[3 * row + 1], w == nullptr ? 0 : weights[row], parts[row]) ? 0U : 1U;
    EXPECT_EQ(wrong, 0U);
    return true;
  }

 private:
  void swap(std::size_t row, std::size_t with) {
    std::swap(ids[row], ids[with]);
    std::swap_ranges(&xyz[3 * row], &xyz[3 * row] + 3, &xyz[3 * with]);
    if (!weights.empty()) std::swap(weights[row], weights[with]);
  }
};

}  // namespace rcb::client
