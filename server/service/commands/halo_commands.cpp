// halo, neighbours: which particles each part needs besides its own, and whose. The cuts alone tell (common/cuts).
#include <algorithm>
#include <array>
#include <cmath>
#include <span>
#include <utility>
#include <vector>

#include <fmt/format.h>

#include "common/base/index.hpp"
#include "common/layout/layout.hpp"
#include "common/particles/by_part.hpp"
#include "server/service/commands/geometry_fields.hpp"
#include "server/service/context/collective.hpp"
#include "server/service/context/context.hpp"

namespace rcb::service {
namespace {

constexpr std::uint64_t kEntriesMax = std::uint64_t{1} << 26U;  // of an answer
constexpr double kImagesMax = 65536;                            // of a particle
// What a rank looks at between two looks at the clock; of the entries that it finds memory is kept in bounds, too.
constexpr std::size_t kPieceRows = std::size_t{1} << 17U;
constexpr std::size_t kPieceEntries = std::size_t{1} << 21U;

Status too_wide(const std::string& what) { return {Code::too_large, what, "give a smaller width"}; }

template <typename T>
bool can_extend(Buffer<T>& buffer, std::size_t more) {
  const std::size_t size = buffer.size() + more;
  return size <= buffer.capacity() || buffer.try_reserve(std::max(size, 2 * buffer.capacity()));
}

// How many entries of the part `from` the part `to` needs.
struct Demand {
  std::int32_t from;
  std::int32_t to;
  std::uint64_t count;
};

bool by_parts(const Demand& a, const Demand& b) { return std::pair(a.from, a.to) < std::pair(b.from, b.to); }

// A row for each entry.
struct Lists {
  Buffer<particles::Id> id;
  Buffer<std::int32_t> from;
  Buffer<std::int32_t> to;
  Buffer<std::int32_t> shift;  // [entries][dims]; empty where nothing is periodic
};

// The halo entries of this rank's particles, piece by piece. Part after part, so that what is told comes in the order
// of the answer: ranks have ascending parts. Local.
class HaloSearch {
 public:
  enum class Kept { counts, lists };

  HaloSearch(const Scene& scene, const cuts::Cuts& cuts, const cuts::Near& near, layout::PartRange own, Kept kept)
      : scene_(scene), cuts_(cuts), near_(near), kept_(kept) {
    by_ = particles::by_part(scene.part.span(), own.begin, own.end);
    const auto by_id = [&scene](std::size_t a, std::size_t b) { return scene.particles.id[a] < scene.particles.id[b]; };
    for (std::size_t p = 0; kept == Kept::lists && p + 1 < by_.start.size(); ++p)
      std::sort(by_.particle.begin() + static_cast<std::ptrdiff_t>(by_.start[p]),
                by_.particle.begin() + static_cast<std::ptrdiff_t>(by_.start[p + 1]), by_id);
  }

  bool done() const { return next_ == by_.particle.size(); }
  const Buffer<Demand>& demands() const { return demands_; }
  const Lists& lists() const { return lists_; }
  std::uint64_t kept() const { return kept_ == Kept::lists ? lists_.id.size() : demands_.size(); }

  // Looks at some more particles. Errors: those of Cuts::halo().
  Status advance() {
    const std::size_t count = std::min(piece_, by_.particle.size() - next_);
    if (count == 0) return {};
    gather(std::span(by_.particle).subspan(next_, count));
    cuts::HaloOptions options;
    options.ids = id_.span();
    options.last_part = part_.span();
    options.near = near_;
    options.entries_max = kPieceEntries;
    std::array<const double*, geometry::kDimsMax> axes{};
    for (std::size_t a = 0; a < axes.size(); ++a) axes[a] = position_[a].data();
    const auto found = cuts_.halo(cuts::Positions::axes(std::span(axes).first(at(cuts_.dims())), count), options);
    if (!found.ok() && found.status().code() == Code::too_large) {
      if (count == 1) return too_wide("the halos of one particle: " + found.status().message());
      piece_ = count / 2;
      return {};
    }
    if (!found.ok()) return found.status();
    next_ += count;
    if (found->entries() < kPieceEntries / 4) piece_ = std::min(2 * piece_, kPieceRows);
    if (count_entries(*found) && (kept_ == Kept::counts || list(*found))) return {};
    return too_wide("no memory for the halos");
  }

 private:
  void gather(std::span<const std::size_t> rows) {
    for (std::size_t a = 0; a < at(cuts_.dims()); ++a) {
      position_[a].resize(rows.size());
      for (std::size_t k = 0; k < rows.size(); ++k) position_[a][k] = scene_.particles.position[a][rows[k]];
    }
    id_.resize(rows.size());
    part_.resize(rows.size());
    for (std::size_t k = 0; k < rows.size(); ++k) {
      id_[k] = scene_.particles.id[rows[k]];
      part_[k] = scene_.part[rows[k]];
    }
  }

  bool count_entries(const cuts::Halo& halo) {
    // The first part of this piece may be the last one of the piece before.
    std::size_t begin = demands_.size();
    while (begin > 0 && demands_[begin - 1].from == part_[0]) --begin;
    for (std::size_t to = 0; to < halo.targets(); ++to) {
      const std::size_t first = demands_.size();
      for (const std::uint64_t row : halo.rows_for(to)) {  // ascending, so their parts are, too
        if (demands_.size() == first || demands_[demands_.size() - 1].from != part_[row]) {
          if (!can_extend(demands_, 1)) return false;
          demands_.push_back({part_[row], static_cast<std::int32_t>(to), 0});
        }
        ++demands_[demands_.size() - 1].count;
      }
    }
    std::sort(demands_.begin() + begin, demands_.end(), by_parts);
    std::size_t kept = begin;
    for (std::size_t k = begin; k < demands_.size(); ++k)
      if (kept > begin && !by_parts(demands_[kept - 1], demands_[k]))
        demands_[kept - 1].count += demands_[k].count;
      else
        demands_[kept++] = demands_[k];
    demands_.resize(kept);
    return true;
  }

  // From lists by part to lists by particle.
  bool list(const cuts::Halo& halo) {
    const std::size_t dims = halo.shift.empty() ? 0 : at(halo.dims);
    std::size_t end = lists_.id.size();
    const std::size_t more = halo.entries();
    if (!can_extend(lists_.id, more) || !can_extend(lists_.from, more) || !can_extend(lists_.to, more) ||
        !can_extend(lists_.shift, more * dims))
      return false;
    lists_.id.resize(end + more);
    lists_.from.resize(end + more);
    lists_.to.resize(end + more);
    lists_.shift.resize((end + more) * dims);
    std::vector<std::size_t> next(id_.size(), 0);  // where each particle's next entry goes
    for (const std::uint64_t row : halo.row) ++next[row];
    for (std::size_t& place : next) end += std::exchange(place, end);
    for (std::size_t to = 0; to < halo.targets(); ++to)
      for (std::uint64_t e = halo.offset[to]; e < halo.offset[to + 1]; ++e) {
        const std::uint64_t row = halo.row[e];
        const std::size_t k = next[row]++;
        lists_.id[k] = id_[row];
        lists_.from[k] = part_[row];
        lists_.to[k] = static_cast<std::int32_t>(to);
        std::copy_n(halo.shift.begin() + e * dims, dims, lists_.shift.begin() + k * dims);
      }
    return true;
  }

  const Scene& scene_;
  const cuts::Cuts& cuts_;
  const cuts::Near& near_;
  const Kept kept_;
  particles::ByPart by_;
  std::size_t next_ = 0;  // in by_.particle
  std::size_t piece_ = kPieceRows;
  // The particles of a piece.
  std::array<Buffer<double>, geometry::kDimsMax> position_;
  Buffer<particles::Id> id_;
  Buffer<std::int32_t> part_;
  Buffer<Demand> demands_;
  Lists lists_;
};

// Errors: those of HaloSearch and of check_time, too_large. Collective.
Status run(Context& context, HaloSearch& search) {
  for (;;) {
    if (Status status = agree_status(context.comm, search.advance()); !status.ok()) return status;
    std::array<std::uint64_t, 2> sums{search.done() ? 0U : 1U, search.kept()};
    context.comm.all_sum(sums);
    if (sums[1] > kEntriesMax)
      return too_wide(fmt::format("an answer about halos has at most {} entries", kEntriesMax));
    if (sums[0] == 0) return {};
    if (Status status = context.check_time(); !status.ok()) return status;
  }
}

// Rank 0 appends all ranks' values as an array. Errors: those of check_time. Collective.
template <typename T>
Status append(Context& context, Response& response, const char* name, const char* dtype, const Buffer<T>& values,
              std::size_t columns = 0) {
  if (Status status = context.check_time(); !status.ok()) return status;
  Buffer<T> all = gather_values<T>(context.comm, values.span());
  const std::uint64_t count = all.size();
  if (!context.root()) return {};
  response.arrays.push_back(make_array(name, dtype, count, all.template release_as<std::byte>()));
  if (columns > 0) response.arrays.back().shape = {count / columns, columns};
  return {};
}

// Collective.
void append_demands(Context& context, Response& response, const HaloSearch& search) {
  const Buffer<Demand> all = gather_values<Demand>(context.comm, search.demands().span());
  Buffer<std::int32_t> from(all.size()), to(all.size());
  Buffer<std::uint64_t> count(all.size());
  std::uint64_t entries = 0;
  for (std::size_t k = 0; k < all.size(); ++k) {
    from[k] = all[k].from;
    to[k] = all[k].to;
    entries += count[k] = all[k].count;
  }
  if (!context.root()) return;
  response.json["entries"] = entries;
  response.arrays.push_back(make_array("from", "<i4", all.size(), from.release_as<std::byte>()));
  response.arrays.push_back(make_array("to", "<i4", all.size(), to.release_as<std::byte>()));
  response.arrays.push_back(make_array("count", "<i8", all.size(), count.release_as<std::byte>()));
}

Response about_cuts(Scene& s) {
  return done({{"scene", s.name},
               {"epoch", s.epoch},
               {"hash", wire::hex64(s.hash)},
               {"dims", s.options.dims},
               {"parts", s.options.parts}});
}

// How many images of how many parts may be within the width of one part. Errors: too_large.
Status check_reach(const cuts::Near& near, const SceneOptions& options) {
  constexpr double kReachMax = 1U << 25U;  // a million parts, and the images next to the box
  double images = 1;
  for (std::size_t a = 0; a < at(options.dims); ++a)
    if (near.box.periodic(a)) images *= 2 * std::ceil(near.width / near.box.length(a)) + 1;
  if (images <= kImagesMax && images * options.parts <= kReachMax) return {};
  return too_wide(
      fmt::format("a width of {} reaches {:.3g} periodic images of {} parts", near.width, images, options.parts));
}

Response halo(Context& context, Scene& s, const wire::Json& request) {
  const auto near = near_fields(request, s.options.dims);
  if (!near.ok()) return failed(near.status());
  const auto lists = wire::bool_field(request, "lists");
  if (!lists.ok()) return failed(lists.status());
  if (Status status = check_reach(*near, s.options); !status.ok()) return failed(std::move(status));
  constexpr std::uint64_t kBytesOfPart = 512;
  constexpr std::uint64_t kBytesOfPiece = std::uint64_t{256} << 20U;
  const std::uint64_t bytes = s.part.size() * 8 + at(s.options.parts) * kBytesOfPart + kBytesOfPiece;
  if (Status room = agree_room(context.comm, bytes, fmt::format("the halos of {} parts", s.options.parts)); !room.ok())
    return failed(std::move(room));
  HaloSearch search(s, s.snapshot(), *near,
                    layout::parts_of_rank(context.comm.rank(), s.options.parts, context.comm.size()),
                    *lists ? HaloSearch::Kept::lists : HaloSearch::Kept::counts);
  if (Status status = run(context, search); !status.ok()) return failed(std::move(status));
  std::array<std::uint64_t, 2> found{search.demands().size(), search.lists().id.size()};
  context.comm.all_sum(found);
  // Each array as it is gathered, and as it is answered.
  const std::uint64_t answer = found[0] * 48 + found[1] * (40 + 4 * at(s.options.dims));
  if (Status room = agree_room(context.comm, context.root() ? answer : 0, "these halos"); !room.ok())
    return failed(too_wide(room.message()));
  Response response = about_cuts(s);
  response.json["n"] = s.n;
  append_demands(context, response, search);
  Status status;
  if (*lists) {
    const bool shifts = near->box.any(s.options.dims);
    if (status.ok()) status = append(context, response, "id", "<i8", search.lists().id);
    if (status.ok()) status = append(context, response, "list_from", "<i4", search.lists().from);
    if (status.ok()) status = append(context, response, "list_to", "<i4", search.lists().to);
    if (status.ok() && shifts)
      status = append(context, response, "shift", "<i4", search.lists().shift, at(s.options.dims));
  }
  return status.ok() ? std::move(response) : failed(std::move(status));
}

// Adds the neighbours of each part. Local. Errors: those of Cuts::neighbours() and check_time_here(), too_large.
Status find_neighbours(const Context& context, const cuts::Cuts& cuts, const cuts::Near& near, Response& response) {
  const std::size_t dims = near.box.any(cuts.dims()) ? at(cuts.dims()) : 0;
  Buffer<std::int64_t> offset;
  Buffer<std::int32_t> part, shift;
  offset.push_back(0);
  for (int p = 0; p < cuts.parts(); ++p) {
    if (Status status = context.check_time_here(); !status.ok()) return status;
    const auto found = cuts.neighbours(p, near);
    if (!found.ok()) return found.status();
    if (part.size() + found->size() > kEntriesMax)
      return too_wide(fmt::format("an answer about neighbours has at most {} entries", kEntriesMax));
    if (!can_extend(part, found->size()) || !can_extend(shift, dims * found->size()))
      return too_wide("no memory for the neighbours");
    for (const cuts::Neighbour& neighbour : *found) {
      part.push_back(neighbour.part);
      for (std::size_t a = 0; a < dims; ++a) shift.push_back(neighbour.shift[a]);
    }
    offset.push_back(static_cast<std::int64_t>(part.size()));
  }
  const std::uint64_t offsets = offset.size();
  const std::uint64_t entries = part.size();
  response.arrays.push_back(make_array("offset", "<i8", offsets, offset.release_as<std::byte>()));
  response.arrays.push_back(make_array("part", "<i4", entries, part.release_as<std::byte>()));
  if (dims == 0) return {};
  response.arrays.push_back(make_array("shift", "<i4", entries, shift.release_as<std::byte>()));
  response.arrays.back().shape = {entries, dims};
  return {};
}

Response neighbours(Context& context, Scene& s, const wire::Json& request) {
  const auto near = near_fields(request, s.options.dims);
  if (!near.ok()) return failed(near.status());
  if (!context.root()) return {};
  if (Status status = check_reach(*near, s.options); !status.ok()) return failed(std::move(status));
  Response response = about_cuts(s);
  if (Status status = find_neighbours(context, s.snapshot(), *near, response); !status.ok())
    return failed(std::move(status));
  return response;
}

constexpr Command kHaloCommands[] = {{"halo", halo, Needs::positions, true}, {"neighbours", neighbours, Needs::cuts}};

}  // namespace

std::span<const Command> halo_commands() { return kHaloCommands; }

}  // namespace rcb::service
