// Clients of the service without sockets: what they push, as the socket side gives it to the ranks.
#pragma once

#include <algorithm>
#include <cstring>
#include <map>
#include <memory>
#include <mutex>
#include <numeric>
#include <string>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "common/base/axis_names.hpp"
#include "common/base/clock.hpp"
#include "common/base/random.hpp"
#include "common/files/shared_memory.hpp"
#include "common/layout/layout.hpp"
#include "tests/server/service/service_with_ledgers.hpp"

namespace rcb::testing {

inline const SteadyClock kClock;

struct Particles {
  int dims = 3;
  std::vector<std::vector<double>> position;  // [dims][n]
  std::vector<std::int64_t> ids;              // empty: row numbers
  std::vector<double> weights;                // empty: none

  std::size_t count() const { return position.empty() ? 0 : position[0].size(); }
};

inline Particles random_particles(std::uint64_t seed, std::size_t n, int dims) {
  Random random(seed);
  Particles particles;
  particles.dims = dims;
  particles.position.assign(static_cast<std::size_t>(dims), std::vector<double>(n));
  for (auto& axis : particles.position)
    for (double& value : axis) value = random.uniform();
  return particles;
}

inline void drift(Particles& particles, std::uint64_t seed, double width) {
  Random random(seed);
  for (auto& axis : particles.position)
    for (double& value : axis) value += random.uniform(-width, width);
}

inline std::int64_t id_of(const Particles& particles, std::size_t row) {
  return particles.ids.empty() ? static_cast<std::int64_t>(row) : particles.ids[row];
}

template <typename T>
std::vector<T> values_of(const Response& response, const std::string& name) {
  const wire::Array* array = wire::find_array(response.arrays, name);
  if (array == nullptr) return {};
  std::uint64_t shaped = 1;
  for (const std::uint64_t length : array->shape) shaped *= length;
  EXPECT_EQ(shaped * sizeof(T), array->bytes.size()) << name;
  std::vector<T> values(array->bytes.size() / sizeof(T));
  if (!values.empty()) std::memcpy(values.data(), array->bytes.data(), array->bytes.size());
  return values;
}

// How a block's rows come to the ranks: through the endpoint, over their sockets, from memory that they read by a list
// of rows, or from memory of which each reads the rows of the particles that it holds (a first time: an even share).
enum class Path { gateway, direct, listed, held };

// The rows of one client, or of one seat.
struct Block {
  int seat = 0;
  std::vector<std::size_t> rows;  // of the particles
  Path path = Path::gateway;
  std::vector<int> ranks;      // by row, to whom it goes; empty: an even share to each
  std::vector<int> by_socket;  // of Path::listed: ranks that get their rows over sockets all the same
  bool is_float32 = false;
};

inline Block all_rows(const Particles& particles, Path path = Path::gateway) {
  Block block{.path = path};
  for (std::size_t row = 0; row < particles.count(); ++row) block.rows.push_back(row);
  return block;
}

// What the socket side makes of blocks: the fields of an order, and this rank's slices.
class Blocks {
 public:
  // ids: the rows have ids. Without, those of a block must be all, in order.
  Blocks(const comm::Comm& comm, const Particles& particles, std::vector<Block> blocks, bool ids)
      : comm_(comm), particles_(particles), blocks_(std::move(blocks)), ids_(ids) {}

  void put(Json& request, std::vector<PushSlice>& slices) const {
    std::uint64_t n = 0;
    bool float32 = true;
    request["blocks"] = Json::array();
    for (const Block& block : blocks_) {
      if (block.rows.empty()) continue;
      n += block.rows.size();
      float32 = float32 && block.is_float32;
      request["blocks"].push_back(order_of(block, slices));
    }
    request.update({{"n", n},
                    {"ids", ids_ && n > 0},
                    {"weights", !particles_.weights.empty()},
                    {"dtype", float32 && n > 0 ? "<f4" : "<f8"}});
  }

 private:
  Json order_of(const Block& block, std::vector<PushSlice>& slices) const {
    Json order{{"seat", block.seat}, {"n", block.rows.size()}, {"dtype", block.is_float32 ? "<f4" : "<f8"}};
    if (block.path == Path::gateway) {
      order["way"] = "endpoint";
      if (comm_.rank() == 0) slices.push_back(received(block, block.rows));
      return order;
    }
    std::vector<std::vector<std::size_t>> of_rank(static_cast<std::size_t>(comm_.size()));  // entries of block.rows
    for (std::size_t k = 0; k < block.rows.size(); ++k) of_rank[rank_of(block, k)].push_back(k);
    std::vector<std::uint64_t> counts;
    for (const auto& entries : of_rank) counts.push_back(entries.size());
    const auto rank = static_cast<std::size_t>(comm_.rank());
    const std::uint64_t first = std::accumulate(counts.begin(), counts.begin() + comm_.rank(), std::uint64_t{0});
    if (block.path != Path::held) order["counts"] = counts;
    order.update({{"way", block.path == Path::direct ? "sockets" : "shared-memory"}, {"number", 1}});
    if (block.path == Path::direct || std::ranges::count(block.by_socket, comm_.rank()) > 0) {
      std::vector<std::size_t> rows;
      for (const std::size_t k : of_rank[rank]) rows.push_back(block.rows[k]);
      if (rows.empty()) return order;
      slices.push_back(received(block, rows));
      slices.back().first_row = first;
      return order;
    }
    PushSlice slice = shared(block, of_rank);
    slice.count = block.path == Path::listed ? counts[rank] : 0;
    slice.first_row = block.path == Path::listed ? first : 0;
    slices.push_back(std::move(slice));
    return order;
  }

  std::size_t rank_of(const Block& block, std::size_t k) const {
    if (!block.ranks.empty()) return static_cast<std::size_t>(block.ranks[k]);
    int rank = 0;
    while (layout::row_begin(rank + 1, block.rows.size(), comm_.size()) <= k) ++rank;
    return static_cast<std::size_t>(rank);
  }

  std::vector<double> doubles(const Block& block, const std::vector<double>& of) const {
    std::vector<double> own;
    for (const std::size_t row : block.rows) own.push_back(of[row]);
    return own;
  }

  // As the connections give them: float32 is widened as it arrives.
  PushSlice received(const Block& block, const std::vector<std::size_t>& rows) const {
    PushSlice slice{.seat = block.seat, .count = rows.size(), .is_float32 = block.is_float32};
    const auto add = [&](const char* name, const char* dtype, const auto& value_of) {
      wire::Array array{name, dtype, {rows.size()}, Buffer<std::byte>(rows.size() * 8)};
      for (std::size_t k = 0; k < rows.size(); ++k) {
        const auto value = value_of(rows[k]);
        std::memcpy(array.bytes.data() + 8 * k, &value, 8);
      }
      slice.arrays.push_back(std::move(array));
    };
    for (std::size_t a = 0; a < particles_.position.size(); ++a)
      add(kAxisNames[a], "<f8", [&](std::size_t row) { return particles_.position[a][row]; });
    if (!particles_.weights.empty()) add("w", "<f8", [&](std::size_t row) { return particles_.weights[row]; });
    if (ids_) add("id", "<i8", [&](std::size_t row) { return id_of(particles_, row); });
    return slice;
  }

  // Columns with gaps between the rows, in which lie numbers that must not be read. Each rank has memory of its own.
  PushSlice shared(const Block& block, const std::vector<std::vector<std::size_t>>& of_rank) const {
    PushSlice slice{.seat = block.seat, .rows = block.rows.size(), .is_float32 = block.is_float32};
    std::vector<std::byte> bytes;
    const auto add = [&](const char* name, const auto& values) {
      const std::uint64_t width = sizeof(values[0]), stride = 2 * width;
      slice.shared.push_back({{name, 1, bytes.size(), stride}, nullptr});
      bytes.resize(bytes.size() + (values.size() * stride + 7) / 8 * 8, std::byte{0xFF});
      for (std::size_t k = 0; k < values.size(); ++k)
        std::memcpy(bytes.data() + slice.shared.back().where.offset + k * stride, &values[k], width);
    };
    for (std::size_t a = 0; a < particles_.position.size(); ++a) {
      const std::vector<double> wide = doubles(block, particles_.position[a]);
      if (block.is_float32)
        add(kAxisNames[a], std::vector<float>(wide.begin(), wide.end()));
      else
        add(kAxisNames[a], wide);
    }
    if (!particles_.weights.empty()) add("w", doubles(block, particles_.weights));
    std::vector<std::int64_t> ids;
    for (const std::size_t row : block.rows) ids.push_back(id_of(particles_, row));
    if (ids_) add("id", ids);
    std::vector<std::uint64_t> listed;
    for (const auto& entries : of_rank) listed.insert(listed.end(), entries.begin(), entries.end());
    if (block.path == Path::listed) add("row", listed);
    auto made = SharedMemory::create(std::max<std::size_t>(bytes.size(), 1));
    EXPECT_TRUE(made.ok()) << made.status().message();
    std::ranges::copy(bytes, made->writable().begin());
    const auto memory = std::make_shared<const SharedMemory>(std::move(*made));
    for (api::SharedColumn& column : slice.shared) column.memory = memory;
    return slice;
  }

  const comm::Comm& comm_;
  const Particles& particles_;
  std::vector<Block> blocks_;
  bool ids_;
};

// Every rank makes one over its own Service; all do the same.
class Driver {
 public:
  Driver(comm::Comm& comm, Service& service, std::string scene)
      : comm_(comm), service_(service), scene_(std::move(scene)) {}

  Response create(Json options) {
    options["command"] = "scene.create";
    options["scene"] = scene_;
    return service_.execute(options);
  }

  Response ask(const std::string& command, Json arguments = Json::object()) {
    arguments["command"] = command;
    arguments["scene"] = scene_;
    return service_.execute(arguments);
  }

  // By one client, all rows in order, by `path`; rows with ids can't be found by the particles held, and are listed.
  Response push(const Particles& particles, std::int64_t step, const std::string& session = "s") {
    const Path way = path == Path::held && !particles.ids.empty() ? Path::listed : path;
    return push(particles, {all_rows(particles, way)}, step, !particles.ids.empty(), 1, {{"session", session}});
  }

  // more: fields of the order.
  Response push(const Particles& particles, std::vector<Block> blocks, std::int64_t step, bool ids, int seats,
                const Json& more = Json::object()) {
    Json request{{"command", "push"}, {"scene", scene_},         {"session", "s"},
                 {"step", step},      {"seats", seats},          {"step_seconds", step_seconds},
                 {"attempt", 0},      {"cuts_known", cuts_known}};
    std::vector<PushSlice> slices;
    Blocks(comm_, particles, std::move(blocks), ids).put(request, slices);
    request.update(more);
    return service_.execute(request, std::move(slices));
  }

  Path path = Path::gateway;
  Json step_seconds;  // said with every push; null: nothing
  Json cuts_known;    // likewise

 private:
  comm::Comm& comm_;
  Service& service_;
  std::string scene_;
};

// One with a service of its own, on which its scene is made.
struct OwnService {
  Service service;
};
class OwnDriver : public OwnService, public Driver {
 public:
  OwnDriver(comm::Comm& comm, const std::string& scene, const Json& options, service::ServiceOptions of_service = {})
      : OwnService{Service(comm, kClock, std::move(of_service))}, Driver(comm, service, scene) {
    create(options);
  }
};

// The first answer of a name, of any rank count, is the reference for the others.
class Reference {
 public:
  void check(const std::string& name, const Json& value) {
    const std::lock_guard lock(mutex_);
    const auto [found, added] = values_.emplace(name, value);
    EXPECT_EQ(found->second, value) << name << (added ? " (the first)" : "");
  }

 private:
  std::mutex mutex_;
  std::map<std::string, Json> values_;
};

}  // namespace rcb::testing
