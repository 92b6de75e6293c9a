// Steps of particles for the tests of pushes, and how they are told: in which blocks, by which ways.
#pragma once

#include <cmath>
#include <numeric>
#include <string>
#include <utility>
#include <vector>

#include "tests/server/service/driver.hpp"

namespace rcb::testing {

inline std::vector<std::size_t> shuffled(std::size_t count, Random& random) {
  std::vector<std::size_t> rows(count);
  std::iota(rows.begin(), rows.end(), std::size_t{0});
  for (std::size_t k = count; k > 1; --k) std::swap(rows[k - 1], rows[random.below(k)]);
  return rows;
}

inline void add_particles(Particles& particles, std::size_t count, bool ids, bool weights, Random& random) {
  particles.position.resize(static_cast<std::size_t>(particles.dims));
  for (std::size_t k = 0; k < count; ++k) {
    for (auto& axis : particles.position) axis.push_back(random.uniform());
    if (weights) particles.weights.push_back(random.below(5) == 0 ? 0 : random.uniform(0, 3));
    if (ids) particles.ids.push_back(static_cast<std::int64_t>(random.next() >> 1U));
  }
}

// Keeps these rows, in this order.
inline void keep_rows(Particles& particles, const std::vector<std::size_t>& rows) {
  const auto keep = [&rows](auto& values) {
    if (values.empty()) return;
    auto kept = values;
    kept.clear();
    for (const std::size_t row : rows) kept.push_back(values[row]);
    values = std::move(kept);
  };
  for (auto& axis : particles.position) keep(axis);
  keep(particles.weights);
  keep(particles.ids);
}

inline Particles with_ids(std::uint64_t seed, std::size_t n, int dims) {
  Particles particles = random_particles(seed, n, dims);
  for (std::size_t k = 0; k < n; ++k) particles.ids.push_back(100 + 3 * static_cast<std::int64_t>((k * 37) % n));
  return particles;
}

// The id whose mix64() this is.
inline std::uint64_t unmix64(std::uint64_t value) {
  const auto inverse = [](std::uint64_t odd) {
    std::uint64_t found = odd;
    for (int k = 0; k < 6; ++k) found *= 2 - odd * found;
    return found;
  };
  const auto unshift = [](std::uint64_t x, unsigned by) { return x ^ (x >> by) ^ (x >> 2 * by); };
  value = unshift(value, 31) * inverse(0x94D049BB133111EBU);
  value = unshift(value, 27) * inverse(0xBF58476D1CE4E5B9U);
  return unshift(value, 30) - 0x9E3779B97F4A7C15U;
}

// Gives one particle the id of the first, and another an id with which the sum over all of mix64(id) stays.
inline Particles with_twins_of_the_same_sum(Particles particles) {
  const auto mixed = [&particles](std::size_t row) { return mix64(static_cast<std::uint64_t>(particles.ids[row])); };
  std::uint64_t third = ~std::uint64_t{0};
  std::size_t row = 1;
  for (; third >> 63U != 0; ++row) third = unmix64(mixed(row) + mixed(2 * row) - mixed(0));
  particles.ids[2 * (row - 1)] = static_cast<std::int64_t>(third);
  particles.ids[row - 1] = particles.ids[0];
  return particles;
}

inline void to_random_ranks(Block& block, int ranks, Random& random) {
  const bool all_to_one = random.below(5) == 0;
  const auto any = [&] { return static_cast<int>(random.below(static_cast<std::uint64_t>(ranks))); };
  const int one = any();
  for (std::size_t k = 0; k < block.rows.size(); ++k) block.ranks.push_back(all_to_one ? one : any());
  if (block.path == Path::listed) block.by_socket = {one};
}

// All rows by one client, where it may choose to any ranks.
inline std::vector<Block> dealt(const comm::Comm& comm, const Particles& particles, Path path, std::uint64_t seed = 1) {
  Random random(seed);
  Block block = all_rows(particles, path);
  if (path == Path::direct || path == Path::listed) to_random_ranks(block, comm.size(), random);
  if (particles.ids.empty()) block.by_socket.clear();
  if (path == Path::direct && particles.ids.empty()) std::ranges::sort(block.ranks);  // rows are their ids
  return {block};
}

// The same by seats in turn.
inline std::vector<Block> shares(const comm::Comm& comm, const Particles& particles, std::size_t seats, Path path) {
  std::vector<Block> blocks(seats);
  for (std::size_t row = 0; row < particles.count(); ++row) blocks[row % seats].rows.push_back(row);
  for (std::size_t k = 0; k < seats; ++k) {
    blocks[k].seat = static_cast<int>(k);
    blocks[k].path = path;
    Random random(k);
    if (path != Path::gateway) to_random_ranks(blocks[k], comm.size(), random);
  }
  return blocks;
}

inline Json flow(std::uint64_t inserted, std::uint64_t removed) {
  return {{"inserted", inserted}, {"removed", removed}};
}

// Whether an answer to `fetch` has these particles, each once, with its values.
inline void check_particles(const Response& fetched, const Particles& particles) {
  ASSERT_TRUE(fetched.status.ok()) << fetched.status.message();
  std::map<std::int64_t, std::size_t> row_of;
  for (std::size_t row = 0; row < particles.count(); ++row) row_of[id_of(particles, row)] = row;
  const auto ids = values_of<std::int64_t>(fetched, "id");
  std::vector<std::int64_t> expected;
  for (const auto& [id, row] : row_of) expected.push_back(id);
  ASSERT_EQ(ids, expected);
  for (std::size_t a = 0; a <= particles.position.size(); ++a) {
    const bool axis = a < particles.position.size();
    if (!axis && particles.weights.empty()) continue;
    const auto& own = axis ? particles.position[a] : particles.weights;
    const auto values = values_of<double>(fetched, axis ? kAxisNames[a] : "w");
    ASSERT_EQ(values.size(), ids.size());
    std::size_t wrong = 0;
    for (std::size_t k = 0; k < ids.size(); ++k) wrong += values[k] == own[row_of[ids[k]]] ? 0U : 1U;
    EXPECT_EQ(wrong, 0U);
  }
}

// A scene that must stay as it is while pushes are refused.
class Refusing {
 public:
  Refusing(comm::Comm& comm, const Json& options) : comm_(comm), driver_(comm, "r", options) {}
  Driver& driver() { return driver_; }

  template <typename... Arguments>
  void refused(Code code, const std::vector<std::string>& words, const Arguments&... arguments) {
    const Response shown = driver_.ask("scene.show"), fetched = driver_.ask("fetch");
    const Response refused = driver_.push(arguments...);
    const Response shown_after = driver_.ask("scene.show"), fetched_after = driver_.ask("fetch");
    if (comm_.rank() != 0) return;
    EXPECT_EQ(refused.status.code(), code) << refused.status.message();
    for (const std::string& word : words)
      EXPECT_NE(refused.status.message().find(word), std::string::npos) << word << ": " << refused.status.message();
    EXPECT_EQ(shown.json, shown_after.json);
    EXPECT_EQ(fetched.json, fetched_after.json);
    EXPECT_EQ(values_of<double>(fetched, "x"), values_of<double>(fetched_after, "x"));
  }

  // Returns the report, on rank 0.
  template <typename... Arguments>
  Json taken(const Arguments&... arguments) {
    const Response pushed = driver_.push(arguments...);
    if (comm_.rank() != 0) return {};
    EXPECT_TRUE(pushed.status.ok()) << pushed.status.message();
    return pushed.json.value("report", Json());
  }

 private:
  comm::Comm& comm_;
  OwnDriver driver_;
};

}  // namespace rcb::testing
