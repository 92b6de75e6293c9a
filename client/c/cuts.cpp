// Cuts: what they tell without the service.
#include "common/cuts/cuts.hpp"

#include <algorithm>
#include <limits>
#include <memory>
#include <utility>
#include <vector>

#include <fmt/format.h>

#include "client/c/call.hpp"
#include "client/c/positions.hpp"
#include "client/c/scene.hpp"
#include "client/c/structs.hpp"
#include "common/wire/limits.hpp"

struct rcbd_cuts final : rcb::c::Handle {
  static constexpr auto kKind = rcb::c::Kind::cuts;
  explicit rcbd_cuts(rcb::cuts::Cuts of) : Handle(kKind), cuts(std::move(of)) {}
  rcb::cuts::Cuts cuts;
};

struct rcbd_lists final : rcb::c::Handle {
  static constexpr auto kKind = rcb::c::Kind::lists;
  rcbd_lists() : Handle(kKind) {}
  explicit rcbd_lists(rcb::cuts::Halo of) : Handle(kKind), halo(std::move(of)) {}

  rcb::cuts::Halo halo;
};

namespace rcb::c {
namespace {

Result<cuts::Near> near_of(const rcbd_near* given, int dims) {
  const auto read = read_struct(given, rcbd_near RCBD_NEAR, "RCBD_NEAR");
  if (!read) return read.status();
  if (read->norm != RCBD_MAX && read->norm != RCBD_EUCLID)
    return Status(Code::invalid_argument, fmt::format("the norm {}", read->norm), "give RCBD_MAX or RCBD_EUCLID");
  const auto box = periodic_box(read->lo, read->hi, dims);
  if (!box) return box.status();
  return cuts::Near{read->width, read->norm == RCBD_MAX ? cuts::Norm::max : cuts::Norm::euclid, *box};
}

struct Question {
  cuts::Positions positions;
  cuts::HaloOptions options;
};

Result<Question> question_of(const rcbd_positions* positions, const rcbd_ask_options* options) {
  const auto rows = positions_of(positions);
  if (!rows) return rows.status();
  const auto given = read_struct(options, rcbd_ask_options RCBD_ASK_OPTIONS, "RCBD_ASK_OPTIONS");
  if (!given) return given.status();
  if (given->entries_max < 0)
    return Status(Code::invalid_argument, fmt::format("at most {} entries", given->entries_max));
  Question question{*rows, {}};
  question.options.ids = optional_array(given->ids, rows->count);
  question.options.last_part = optional_array(given->last_part, rows->count);
  question.options.threads = given->threads;
  question.options.widths = optional_array(given->widths, rows->count);
  question.options.seats = given->seats;
  question.options.entries_max = static_cast<std::uint64_t>(given->entries_max);
  return question;
}

// A question to cuts, whose answer is a list or lists. ask: returns a Result<cuts::Halo>.
template <typename Ask>
int lists_of(rcbd_cuts* cuts, rcbd_lists** to, const Ask& ask) noexcept {
  return call([&]() -> Status {
    if (to == nullptr) return {Code::invalid_argument, "no room for the lists: a null pointer"};
    *to = nullptr;
    if (Status usable = check(cuts); !usable) return usable;
    auto found = ask(cuts->cuts);
    if (found) *to = new rcbd_lists(std::move(*found));
    return found.status();
  });
}

cuts::Halo one_list(int dims, std::size_t entries) {
  cuts::Halo list;
  list.dims = dims;
  list.offset.resize(2);
  list.offset[0] = 0;
  list.offset[1] = entries;
  list.row.resize(entries);
  return list;
}

}  // namespace
}  // namespace rcb::c

using namespace rcb;  // NOLINT: the functions below are not of a namespace

int rcbd_scene_cuts(rcbd_scene* scene, rcbd_cuts** to) {
  return c::call([&]() -> Status {
    if (to == nullptr) return {Code::invalid_argument, "no room for the cuts: a null pointer"};
    *to = nullptr;
    if (Status usable = c::check(scene); !usable) return usable;
    const c::Left left;
    return scene->in_turn(left, [&](client::Scene& open) {
      auto cuts = open.cuts(left.seconds());
      if (cuts) *to = new rcbd_cuts(std::move(*cuts));
      return cuts.status();
    });
  });
}

int rcbd_cuts_describe(rcbd_cuts* cuts, rcbd_cuts_info* info) {
  return c::call([&]() -> Status {
    if (Status usable = c::check(cuts); !usable) return usable;
    const rcbd_cuts_info told{sizeof(rcbd_cuts_info), static_cast<std::int64_t>(cuts->cuts.epoch()), cuts->cuts.hash(),
                              cuts->cuts.parts(), cuts->cuts.dims()};
    return c::write_struct(told, info, "RCBD_CUTS_INFO");
  });
}

int rcbd_cuts_regions(rcbd_cuts* cuts, double* lo, double* hi) {
  return c::call([&]() -> Status {
    if (Status usable = c::check(cuts); !usable) return usable;
    if (lo == nullptr || hi == nullptr) return {Code::invalid_argument, "no room for regions: a null pointer"};
    const auto dims = static_cast<std::size_t>(cuts->cuts.dims());
    for (const geometry::Box& region : cuts->cuts.regions()) {
      lo = std::copy_n(region.lo.begin(), dims, lo);
      hi = std::copy_n(region.hi.begin(), dims, hi);
    }
    return {};
  });
}

int rcbd_cuts_owner(rcbd_cuts* cuts, const rcbd_positions* positions, const rcbd_ask_options* options,
                    std::int32_t* part) {
  return c::call([&]() -> Status {
    if (Status usable = c::check(cuts); !usable) return usable;
    const auto question = c::question_of(positions, options);
    if (!question) return question.status();
    const std::size_t count = question->positions.count;
    if (part == nullptr && count > 0) return {Code::invalid_argument, "no room for parts: a null pointer"};
    return cuts->cuts.owner(question->positions, question->options, std::span(part, count));
  });
}

int rcbd_cuts_halo(rcbd_cuts* cuts, const rcbd_positions* positions, const rcbd_near* near,
                   const rcbd_ask_options* options, rcbd_lists** to) {
  return c::lists_of(cuts, to, [&](const cuts::Cuts& asked) -> Result<cuts::Halo> {
    auto question = c::question_of(positions, options);
    if (!question) return question.status();
    const auto within = c::near_of(near, asked.dims());
    if (!within) return within.status();
    question->options.near = *within;
    return asked.halo(question->positions, question->options);
  });
}

int rcbd_cuts_neighbours(rcbd_cuts* cuts, std::int32_t part, const rcbd_near* near, rcbd_lists** to) {
  return c::lists_of(cuts, to, [&](const cuts::Cuts& asked) -> Result<cuts::Halo> {
    const auto within = c::near_of(near, asked.dims());
    if (!within) return within.status();
    const auto found = asked.neighbours(part, *within);
    if (!found) return found.status();
    const auto dims = static_cast<std::size_t>(asked.dims());
    cuts::Halo list = c::one_list(asked.dims(), found->size());
    if (within->box.any(asked.dims())) list.shift.resize(found->size() * dims);
    for (std::size_t k = 0; k < found->size(); ++k) {
      list.row[k] = static_cast<std::uint64_t>((*found)[k].part);
      if (!list.shift.empty()) std::copy_n((*found)[k].shift.begin(), dims, list.shift.data() + k * dims);
    }
    return list;
  });
}

int rcbd_cuts_box(rcbd_cuts* cuts, const double* lo, const double* hi, const rcbd_near* near, rcbd_lists** to) {
  return c::lists_of(cuts, to, [&](const cuts::Cuts& asked) -> Result<cuts::Halo> {
    if (lo == nullptr || hi == nullptr) return Status(Code::invalid_argument, "no box: a null pointer");
    const auto within = c::near_of(near, asked.dims());
    if (!within) return within.status();
    geometry::Box box = geometry::Box::unbounded();
    std::copy_n(lo, asked.dims(), box.lo.begin());
    std::copy_n(hi, asked.dims(), box.hi.begin());
    const auto found = asked.box(box, within->box);
    if (!found) return found.status();
    cuts::Halo list = c::one_list(asked.dims(), found->size());
    std::copy(found->begin(), found->end(), list.row.begin());
    return list;
  });
}

int rcbd_cuts_narrowest(rcbd_cuts* cuts, const rcbd_near* near, std::int32_t* part, std::int32_t* axis, double* width) {
  return c::call([&]() -> Status {
    if (Status usable = c::check(cuts); !usable) return usable;
    if (part == nullptr || axis == nullptr || width == nullptr)
      return {Code::invalid_argument, "no room for part, axis or width: a null pointer"};
    const auto within = c::near_of(near, cuts->cuts.dims());
    if (!within) return within.status();
    if (Status fits = within->check(cuts->cuts.dims()); !fits) return fits;
    const auto found = cuts->cuts.narrowest(within->box);
    *part = found ? found->part : -1;
    *axis = found ? found->axis : -1;
    *width = found ? found->width : std::numeric_limits<double>::infinity();
    return {};
  });
}

int rcbd_lists_read(rcbd_lists* lists, rcbd_lists_view* view) {
  return c::call([&]() -> Status {
    if (Status usable = c::check(lists); !usable) return usable;
    const cuts::Halo& halo = lists->halo;
    // int64_t and uint64_t may stand for each other in memory.
    const rcbd_lists_view told{sizeof(rcbd_lists_view),
                               static_cast<std::int64_t>(halo.targets()),
                               static_cast<std::int64_t>(halo.entries()),
                               reinterpret_cast<const std::int64_t*>(halo.offset.data()),
                               reinterpret_cast<const std::int64_t*>(halo.row.data()),
                               halo.shift.empty() ? nullptr : halo.shift.data()};
    return c::write_struct(told, view, "RCBD_LISTS_VIEW");
  });
}
