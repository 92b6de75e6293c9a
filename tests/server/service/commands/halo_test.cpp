// halo, neighbours, box with periodic borders, and the cuts as arrays, against what the definitions say of the regions
// and parts that `cuts` and `assign` tell.
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <tuple>

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "server/service/service.hpp"
#include "tests/server/service/driver.hpp"
#include "tests/support/on_ranks.hpp"

namespace rcb::testing {
namespace {

constexpr double kEndless = std::numeric_limits<double>::infinity();

using Bounds = std::vector<std::array<double, 2>>;  // by axis

struct Question {
  double width = 0;
  bool euclid = false;
  Bounds periodic;  // infinite: not periodic

  bool repeats(std::size_t a) const { return std::isfinite(periodic[a][0]); }
  Json json() const {
    Json lo = Json::array(), hi = Json::array();
    for (std::size_t a = 0; a < periodic.size(); ++a) {
      lo.push_back(repeats(a) ? Json(periodic[a][0]) : Json());
      hi.push_back(repeats(a) ? Json(periodic[a][1]) : Json());
    }
    return {{"width", width}, {"norm", euclid ? "euclid" : "max"}, {"periodic", {{"lo", lo}, {"hi", hi}}}};
  }
};

std::vector<Bounds> regions_in(const Json& cuts) {
  std::vector<Bounds> regions;
  for (const Json& region : cuts.at("regions")) {
    Bounds& bounds = regions.emplace_back();
    for (std::size_t a = 0; a < region["lo"].size(); ++a)
      bounds.push_back({region["lo"][a].is_null() ? -kEndless : region["lo"][a].get<double>(),
                        region["hi"][a].is_null() ? kEndless : region["hi"][a].get<double>()});
    if (region.contains("empty")) bounds.assign(bounds.size(), {kEndless, -kEndless});
  }
  return regions;
}

// Whether what lies between low and high, moved by k periods, is within the width of the region.
bool is_near(const Bounds& place, const std::vector<int>& k, Bounds region, const Question& question) {
  double most = 0, sum = 0;
  for (std::size_t a = 0; a < region.size(); ++a) {
    if (region[a][0] > region[a][1]) return false;
    const double length = question.repeats(a) ? question.periodic[a][1] - question.periodic[a][0] : 0;
    for (std::size_t side = 0; question.repeats(a) && side < 2; ++side)
      if (std::isinf(region[a][side])) region[a][side] = question.periodic[a][side];
    const double moved = k[a] * length;
    const double distance = std::max({region[a][0] - (place[a][1] + moved), place[a][0] + moved - region[a][1], 0.0});
    most = std::max(most, distance);
    sum += distance * distance;
  }
  return question.euclid ? sum <= question.width * question.width : most <= question.width;
}

// All shifts that may matter for positions in the unit cube, the first axis slowest.
std::vector<std::vector<int>> shifts(const Question& question) {
  std::vector<std::vector<int>> all{{}};
  for (std::size_t a = 0; a < question.periodic.size(); ++a) {
    const int most = question.repeats(a) ? static_cast<int>(question.width) + 3 : 0;
    std::vector<std::vector<int>> longer;
    for (const auto& shift : all)
      for (int k = -most; k <= most; ++k) {
        longer.push_back(shift);
        longer.back().push_back(k);
      }
    all = std::move(longer);
  }
  return all;
}

bool is_zero(const std::vector<int>& shift) { return std::ranges::count(shift, 0) == std::ssize(shift); }

using Entry = std::tuple<int, std::int64_t, int, std::vector<int>>;  // from, id, to, shift

std::vector<Entry> expected_halo(const Particles& particles, const std::vector<std::int64_t>& ids,
                                 const std::vector<std::int32_t>& parts, const std::vector<Bounds>& regions,
                                 const Question& question) {
  std::vector<Entry> entries;
  for (std::size_t k = 0; k < ids.size(); ++k) {
    std::size_t row = static_cast<std::size_t>(ids[k]);
    if (!particles.ids.empty())
      row = static_cast<std::size_t>(std::ranges::find(particles.ids, ids[k]) - particles.ids.begin());
    Bounds place;
    for (const auto& axis : particles.position) place.push_back({axis[row], axis[row]});
    for (int q = 0; q < std::ssize(regions); ++q)
      for (const auto& shift : shifts(question))
        if ((q != parts[k] || !is_zero(shift)) && is_near(place, shift, regions[static_cast<std::size_t>(q)], question))
          entries.emplace_back(parts[k], ids[k], q, shift);
  }
  std::ranges::sort(entries);
  return entries;
}

std::vector<std::vector<int>> shifts_in(const Response& response, std::size_t entries, std::size_t dims, bool any) {
  const auto values = values_of<std::int32_t>(response, "shift");
  EXPECT_EQ(values.size(), any ? entries * dims : 0);
  std::vector<std::vector<int>> list(entries, std::vector<int>(dims));
  for (std::size_t k = 0; k < values.size() && any; ++k) list[k / dims][k % dims] = values[k];
  return list;
}

void check_halo(const Response& counts, const Response& lists, const std::vector<Entry>& expected, std::size_t dims,
                bool any) {
  ASSERT_TRUE(lists.status.ok() && counts.status.ok()) << lists.status.message() << counts.status.message();
  const auto id = values_of<std::int64_t>(lists, "id");
  const auto from = values_of<std::int32_t>(lists, "list_from");
  const auto to = values_of<std::int32_t>(lists, "list_to");
  const auto shift = shifts_in(lists, id.size(), dims, any);
  std::vector<Entry> entries;
  for (std::size_t k = 0; k < id.size(); ++k) entries.emplace_back(from.at(k), id[k], to.at(k), shift[k]);
  EXPECT_EQ(entries, expected);
  std::map<std::pair<int, int>, std::int64_t> sums;
  for (const auto& entry : expected) ++sums[{std::get<0>(entry), std::get<2>(entry)}];
  for (const Response* answer : {&counts, &lists}) {
    EXPECT_EQ(answer->json["entries"], expected.size());
    std::vector<std::pair<std::pair<int, int>, std::int64_t>> found;
    const auto part = values_of<std::int32_t>(*answer, "from");
    for (std::size_t k = 0; k < part.size(); ++k)
      found.push_back(
          {{part[k], values_of<std::int32_t>(*answer, "to").at(k)}, values_of<std::int64_t>(*answer, "count").at(k)});
    EXPECT_EQ(found, decltype(found)(sums.begin(), sums.end()));
  }
  EXPECT_EQ(wire::find_array(counts.arrays, "id"), nullptr);
}

void check_neighbours(const Response& answer, const std::vector<Bounds>& regions, const Question& question) {
  ASSERT_TRUE(answer.status.ok()) << answer.status.message();
  const std::size_t dims = question.periodic.size();
  const auto offset = values_of<std::int64_t>(answer, "offset");
  const auto part = values_of<std::int32_t>(answer, "part");
  bool any = false;
  for (std::size_t a = 0; a < dims; ++a) any = any || question.repeats(a);
  const auto shift = shifts_in(answer, part.size(), dims, any);
  ASSERT_EQ(offset.size(), regions.size() + 1);
  for (std::size_t p = 0; p < regions.size(); ++p) {
    Bounds place = regions[p];
    for (std::size_t a = 0; a < dims; ++a)
      for (std::size_t side = 0; side < 2; ++side)
        if (std::isinf(place[a][side]) && question.repeats(a)) place[a][side] = question.periodic[a][side];
    std::vector<std::pair<int, std::vector<int>>> expected, found;
    for (int q = 0; q < std::ssize(regions); ++q)
      for (const auto& k : shifts(question))
        if ((q != static_cast<int>(p) || !is_zero(k)) && place[0][0] <= place[0][1] &&
            is_near(place, k, regions[static_cast<std::size_t>(q)], question))
          expected.emplace_back(q, k);
    for (auto k = static_cast<std::size_t>(offset[p]); k < static_cast<std::size_t>(offset[p + 1]); ++k)
      found.emplace_back(part.at(k), shift[k]);
    EXPECT_EQ(found, expected) << "part " << p;
  }
}

std::vector<Question> questions(Random& random, int dims) {
  std::vector<Question> list;
  for (const double width : {0.0, 0.02, 0.3, 0.7, 1.6})
    for (const bool euclid : {false, true}) {
      if (dims == 3 && width > 1) continue;
      Question question{width, euclid, Bounds(static_cast<std::size_t>(dims), {-kEndless, kEndless})};
      for (auto& axis : question.periodic)
        if (random.uniform() < 0.5) axis = {0, random.uniform() < 0.5 ? 1 : 0.9};  // some lie outside
      list.push_back(question);
    }
  return list;
}

TEST(Halo, IsWhatTheDefinitionSays) {
  constexpr std::uint64_t kSeed = 41;
  Reference reference;
  on_ranks([&](comm::Comm& comm) {
    Random random(kSeed);
    for (int dims = 1; dims <= 3; ++dims)
      for (const int parts : {1, 3, 8}) {
        SCOPED_TRACE(::testing::Message() << dims << "-D, " << parts << " parts, seed " << kSeed);
        Particles particles = random_particles(kSeed + static_cast<std::uint64_t>(parts), 70, dims);
        for (std::size_t i = 0; i < 30; ++i)  // on each other's planes
          for (auto& axis : particles.position) axis[i] = std::floor(axis[i] * 4) / 4;
        if (parts == 3)
          for (std::int64_t i = 0; i < 70; ++i) particles.ids.push_back(1000 - 7 * i);
        const std::string name = fmt::format("h{}{}", dims, parts);
        OwnDriver driver(comm, name, {{"parts", parts}, {"dims", dims}, {"tolerance", "inf"}});
        driver.push(particles, 0);
        for (std::size_t i = 0; i < 4; ++i)  // who then stand out of the ids' order
          for (auto& axis : particles.position) axis[i] = 1 - axis[i];
        driver.push(particles, 1);
        const Response cuts = driver.ask("cuts");
        const Response assigned = driver.ask("assign");
        for (const Question& question : questions(random, dims)) {
          SCOPED_TRACE(question.json().dump());
          Json with_lists = question.json();
          with_lists["lists"] = true;
          const Response counts = driver.ask("halo", question.json());
          const Response lists = driver.ask("halo", with_lists);
          const Response neighbours = driver.ask("neighbours", question.json());
          if (comm.rank() != 0) continue;
          const auto regions = regions_in(cuts.json);
          bool any = false;
          for (std::size_t a = 0; a < question.periodic.size(); ++a) any = any || question.repeats(a);
          check_halo(counts, lists,
                     expected_halo(particles, values_of<std::int64_t>(assigned, "id"),
                                   values_of<std::int32_t>(assigned, "part"), regions, question),
                     static_cast<std::size_t>(dims), any);
          check_neighbours(neighbours, regions, question);
          reference.check(name + question.json().dump(), lists.json);
        }
      }
  });
}

// More entries than one piece takes.
TEST(Halo, OfEverybodyForEverybody) {
  static constexpr int kParts = 601;  // so that a part is in two pieces
  static constexpr std::size_t kCount = 5000;
  on_ranks({1, 3}, [](comm::Comm& comm) {
    OwnDriver driver(comm, "all", {{"parts", kParts}});
    driver.push(random_particles(3, kCount, 3), 0);
    const Response answer = driver.ask("halo", {{"width", 9}, {"lists", true}});
    const Response assigned = driver.ask("assign");
    if (comm.rank() != 0) return;
    ASSERT_TRUE(answer.status.ok()) << answer.status.message();
    EXPECT_EQ(answer.json["entries"], kCount * (kParts - 1));
    EXPECT_EQ(values_of<std::int32_t>(answer, "from").size(), std::size_t{kParts} * (kParts - 1));
    const auto parts = values_of<std::int32_t>(assigned, "part");
    std::vector<std::int64_t> sizes(kParts);
    for (const std::int32_t part : parts) ++sizes[static_cast<std::size_t>(part)];
    const auto from = values_of<std::int32_t>(answer, "from");
    const auto count = values_of<std::int64_t>(answer, "count");
    for (std::size_t k = 0; k < from.size(); ++k) EXPECT_EQ(count[k], sizes[static_cast<std::size_t>(from[k])]);
    const auto id = values_of<std::int64_t>(answer, "id");
    const auto list_from = values_of<std::int32_t>(answer, "list_from");
    const auto to = values_of<std::int32_t>(answer, "list_to");
    ASSERT_EQ(id.size(), kCount * (kParts - 1));
    std::size_t misplaced = 0;
    for (std::size_t k = 0; k < id.size(); ++k) {
      misplaced += list_from[k] != parts[static_cast<std::size_t>(id[k])] ? 1U : 0U;
      if (k > 0)
        misplaced += std::tuple(list_from[k - 1], id[k - 1], to[k - 1]) >= std::tuple(list_from[k], id[k], to[k]);
    }
    EXPECT_EQ(misplaced, 0U);
  });
}

TEST(Halo, WrongQuestionsAreRefused) {
  on_ranks([](comm::Comm& comm) {
    OwnDriver driver(comm, "w", {{"parts", 2}, {"dims", 2}});
    driver.push(random_particles(3, 20, 2), 0);
    const auto corners = [](Json lo, Json hi) { return Json{{"lo", std::move(lo)}, {"hi", std::move(hi)}}; };
    const Json good{{"width", 0.1}, {"lo", {0, 0}}, {"hi", {1, 1}}};
    std::vector<Json> wrong;
    for (const Json& width : {Json(), Json(-0.1), Json("wide"), Json("inf")}) wrong.push_back({{"width", width}});
    for (const Json& norm : {Json("manhattan"), Json(2)}) wrong.push_back({{"norm", norm}});
    for (const Json& periodic :
         {Json(3), Json::array({0, 1}), Json::object(), corners({0}, {1}), corners({0, 0, 0}, {1, 1, 1}),
          corners({0, 0}, {1, 0}), corners({0, 2}, {1, 1}), corners({0, nullptr}, {1, 1}), corners({0, "a"}, {1, 1}),
          corners({-1.7e308, 0}, {1.7e308, 1})})
      wrong.push_back({{"periodic", periodic}});
    for (const Json& fields : wrong)
      for (const char* command : {"halo", "neighbours", "box"}) {
        if (std::string(command) == "box" && !fields.contains("periodic")) continue;
        Json arguments = good;
        arguments.update(fields);
        const Response answer = driver.ask(command, arguments);
        if (comm.rank() == 0) {
          EXPECT_EQ(answer.status.code(), Code::invalid_argument) << command << arguments << answer.status.message();
        }
      }
    const Response lists = driver.ask("halo", {{"width", 0.1}, {"lists", "all"}});
    if (comm.rank() == 0) {
      EXPECT_EQ(lists.status.code(), Code::invalid_argument);
    }
    for (const char* command : {"halo", "neighbours", "box"}) {
      const Response fine = driver.ask(command, good);
      if (comm.rank() == 0) {
        EXPECT_TRUE(fine.status.ok()) << fine.status.message();
      }
    }
  });
}

TEST(Box, TouchesPartsAcrossPeriodicBorders) {
  on_ranks([](comm::Comm& comm) {
    OwnDriver driver(comm, "b", {{"parts", 8}, {"dims", 1}});
    Particles line;
    line.dims = 1;
    line.position.emplace_back();
    for (int i = 0; i < 80; ++i) line.position[0].push_back(i / 80.0);
    driver.push(line, 0);
    const auto parts = [&](double lo, double hi, const Json& periodic) {
      const Response answer = driver.ask("box", {{"lo", {lo}}, {"hi", {hi}}, {"periodic", periodic}});
      return comm.rank() == 0 ? answer.json.value("parts", Json(answer.status.message())) : Json();
    };
    const Json unit{{"lo", {0}}, {"hi", {1}}}, none{{"lo", {nullptr}}, {"hi", {nullptr}}};
    const Json across = parts(0.95, 1.05, unit), inside = parts(0.05, 0.06, unit), far = parts(7.05, 7.06, unit);
    const Json straight = parts(0.95, 1.05, nullptr), not_periodic = parts(0.95, 1.05, none);
    const Json wide = parts(-1e300, 1e300, unit);
    if (comm.rank() != 0) return;
    EXPECT_EQ(across, Json({0, 7}));
    EXPECT_EQ(inside, Json({0}));
    EXPECT_EQ(far, Json({0}));
    EXPECT_EQ(straight, Json({7}));
    EXPECT_EQ(not_periodic, Json({7}));
    EXPECT_EQ(wide, Json({0, 1, 2, 3, 4, 5, 6, 7}));
  });
}

TEST(Cuts, TellTheNarrowestRegion) {
  on_ranks([](comm::Comm& comm) {
    OwnDriver driver(comm, "n", {{"parts", 7}, {"dims", 2}});
    driver.push(random_particles(11, 300, 2), 0);
    const Response cuts = driver.ask("cuts"), quality = driver.ask("quality");
    OwnDriver whole(comm, "whole", {{"parts", 1}});
    whole.push(random_particles(11, 9, 3), 0);
    const Response none = whole.ask("cuts");
    if (comm.rank() != 0) return;
    double least = kEndless;
    for (const Bounds& region : regions_in(cuts.json))
      for (const auto& [lo, hi] : region)
        if (std::isfinite(hi - lo)) least = std::min(least, hi - lo);
    const Json narrowest = cuts.json["narrowest_region"];
    EXPECT_EQ(narrowest["width"], least);
    const Bounds region = regions_in(cuts.json).at(narrowest["part"].get<std::size_t>());
    const auto [lo, hi] = region.at(narrowest["axis"].get<std::size_t>());
    EXPECT_EQ(hi - lo, least);
    EXPECT_EQ(quality.json["narrowest_region"], narrowest);
    EXPECT_TRUE(none.json.at("narrowest_region").is_null());
  });
}

TEST(Cuts, AsArraysAreThoseOfTheJson) {
  on_ranks([](comm::Comm& comm) {
    for (const int parts : {1, 2, 37}) {
      for (const bool sizes : {false, true}) {
        Json options{{"parts", parts}};
        std::vector<double> shares;
        for (int p = 0; p < parts; ++p) shares.push_back(1 + p % 3);
        if (sizes) options["part_sizes"] = shares;
        OwnDriver driver(comm, "a", options);
        driver.push(random_particles(7, 20, 3), 0);
        const Response json = driver.ask("cuts"), arrays = driver.ask("cuts", {{"list", "arrays"}});
        const Response paged = driver.ask("cuts", {{"list", "arrays"}, {"count", 1}});
        if (comm.rank() != 0) continue;
        EXPECT_EQ(paged.status.code(), Code::invalid_argument);
        for (const char* field : {"epoch", "hash", "method", "parts"}) EXPECT_EQ(arrays.json[field], json.json[field]);
        EXPECT_EQ(arrays.json["dims"], 3);
        EXPECT_EQ(values_of<double>(arrays, "part_sizes"), sizes ? shares : std::vector<double>());
        const auto axes = values_of<std::int32_t>(arrays, "axes");
        const auto at = values_of<double>(arrays, "at");
        const auto id = values_of<std::int64_t>(arrays, "id");
        ASSERT_EQ(id.size(), json.json["cuts"].size());
        for (const char* name : {"axes", "at"})
          EXPECT_EQ(wire::find_array(arrays.arrays, name)->shape, (std::vector<std::uint64_t>{id.size(), 3}));
        for (std::size_t k = 0; k < id.size(); ++k) {
          const Json& cut = json.json["cuts"][k];
          EXPECT_EQ(axes[3 * k], cut["axis"]);
          if (cut["at"].is_null()) {
            EXPECT_EQ(id[k], -1);
            continue;
          }
          EXPECT_EQ(at[3 * k], cut["at"]);
          EXPECT_EQ(id[k], cut["ties"]["id"]);
          for (std::size_t i = 0; i < 2; ++i) {
            EXPECT_EQ(axes[3 * k + 1 + i], cut["ties"]["axes"][i]);
            EXPECT_EQ(at[3 * k + 1 + i], cut["ties"]["at"][i]);
          }
        }
      }
    }
  });
}

// The cuts after a push come with its answer, where its client says that it has others.
TEST(CutsKnown, NewCutsComeWithTheAnswerToThePush) {
  on_ranks({1, 3}, [](comm::Comm& comm) {
    OwnDriver driver(comm, "s", {{"parts", 5}, {"tolerance", 0.2}, {"part_sizes", {1, 2, 1, 1, 1}}});
    Particles particles = random_particles(8, 300, 3);
    const auto expect = [&](const Response& response, std::int64_t epoch) {  // 0: none
      const Response arrays = driver.ask("cuts", {{"list", "arrays"}});
      if (comm.rank() != 0) return;
      ASSERT_TRUE(response.status.ok()) << response.status.message();
      EXPECT_EQ(response.json.contains("cuts"), epoch > 0);
      EXPECT_EQ(wire::find_array(response.arrays, "axes") != nullptr, epoch > 0);
      if (epoch == 0) return;
      EXPECT_EQ(response.json["cuts"], arrays.json);
      EXPECT_EQ(response.json["cuts"]["epoch"], epoch);
      for (const wire::Array& array : arrays.arrays) {
        const wire::Array* const told = wire::find_array(response.arrays, array.name);
        ASSERT_NE(told, nullptr) << array.name;
        EXPECT_EQ(told->shape, array.shape);
        EXPECT_TRUE(std::ranges::equal(told->bytes, array.bytes)) << array.name;
      }
    };
    const auto hash = [&] {
      const Response shown = driver.ask("scene.show");
      std::uint64_t value = comm.rank() == 0 ? wire::parse_hex64(shown.json["hash"].get<std::string>()).value() : 0;
      comm.all_max({&value, 1});
      return wire::hex64(value);
    };
    driver.cuts_known = Json::object();
    expect(driver.push(particles, 0), 1);
    driver.cuts_known = {{"epoch", 1}, {"hash", hash()}};
    drift(particles, 1, 0.001);
    expect(driver.push(particles, 1), 0);
    for (double& x : particles.position[0]) x *= x;
    expect(driver.push(particles, 2), 2);
    expect(driver.push(particles, 2), 0);  // repeated
    driver.cuts_known = {{"epoch", 2}, {"hash", "00000000000000ff"}};
    expect(driver.push(particles, 3), 2);
    driver.cuts_known = nullptr;
    expect(driver.push(particles, 4), 0);
    std::int64_t step = 5;
    for (const Json& odd : {Json(3), Json({{"epoch", -1}}), Json({{"hash", "x"}}), Json({{"epoch", "1"}})}) {
      driver.cuts_known = odd;
      const Status refused = driver.push(particles, step++).status;
      EXPECT_EQ(refused.code(), comm.rank() == 0 ? Code::invalid_argument : Code::ok) << odd.dump();
    }
  });
}

}  // namespace
}  // namespace rcb::testing
