#include "server/service/step/member_results.hpp"

#include <algorithm>
#include <numeric>
#include <optional>

#include "common/layout/layout.hpp"
#include "server/service/context/collective.hpp"

namespace rcb::service {
namespace {

// The results for one member.
struct Results {
  Buffer<particles::Id> changed_id, place_id, inserted_id;
  Buffer<std::int32_t> changed_part, place_rank;
  Buffer<std::uint64_t> place_slot;
};

template <typename T>
void add_array(std::vector<wire::Array>& to, const char* name, const char* dtype, Buffer<T>& values) {
  const std::uint64_t count = values.size();
  to.push_back(make_array(name, dtype, count, values.template release_as<std::byte>()));
}

template <typename T>
Buffer<T> in_order(const Buffer<T>& values, const Buffer<std::uint64_t>& order) {
  Buffer<T> out(order.size());
  for (std::size_t k = 0; k < order.size(); ++k) out[k] = values[order[k]];
  return out;
}

// Goes through a list in ascending id, as it is asked for ascending ids.
class MemberFinder {
 public:
  explicit MemberFinder(const OfMembers& list) : list_(list) {}
  std::optional<std::int32_t> find(particles::Id id) {
    while (at_ < list_.id.size() && list_.id[at_] < id) ++at_;
    if (at_ == list_.id.size() || list_.id[at_] != id) return std::nullopt;
    return list_.member[at_];
  }

 private:
  const OfMembers& list_;
  std::size_t at_ = 0;
};

}  // namespace

Buffer<std::uint64_t> ascending(const Buffer<particles::Id>& ids) {
  const auto n = static_cast<std::uint64_t>(ids.size());
  Buffer<std::uint64_t> order(n);
  std::fill(order.begin(), order.end(), kNone);
  for (std::uint64_t k = 0; k < n; ++k) {
    const auto place = static_cast<std::uint64_t>(ids[k]);
    if (place >= n || order[place] != kNone) return order_by_id(ids);
    order[place] = k;
  }
  return order;
}

Buffer<std::uint64_t> changed_slots(const Scene& scene, const PlacesBefore& before, int members) {
  std::vector<std::int32_t> member_of;
  for (int p = 0; p < scene.options.parts; ++p)
    member_of.push_back(layout::rank_of_part(p, scene.options.parts, members));
  const auto differs = [&](std::size_t i) {
    return before.id[i] != scene.particles.id[i] ||
           (before.part[i] != scene.part[i] &&
            member_of[static_cast<std::size_t>(before.part[i])] != member_of[static_cast<std::size_t>(scene.part[i])]);
  };
  Buffer<std::uint64_t> slots;
  const std::size_t both = std::min(before.id.size(), scene.part.size());
  for (std::size_t i = 0; i < both; ++i)
    if (differs(i)) slots.push_back(i);
  for (std::size_t i = both; i < std::max(before.id.size(), scene.part.size()); ++i) slots.push_back(i);
  return slots;
}

Whereabouts find_places(Context& context, const Scene& scene, const Buffer<std::uint64_t>* slots) {
  Buffer<std::uint64_t> those;  // but for slots that are free now
  if (slots != nullptr) {
    const auto end = std::lower_bound(slots->begin(), slots->end(), scene.part.size());
    those.assign({slots->begin(), end});
  }
  const auto gather = [&]<typename T>(const Buffer<T>& values) {
    return gather_values<T>(context.comm, slots == nullptr ? values.span() : in_order(values, those).span());
  };
  const auto ids = gather(scene.particles.id);
  const auto parts = gather(scene.part);
  auto at = gather_values<std::uint64_t>(context.comm, those.span());
  if (!context.root()) return {};
  for (int rank = 0; slots == nullptr && rank < context.comm.size(); ++rank) {
    const std::size_t first = at.size();
    at.resize(first + held_by(scene, scene.n, rank, context.comm.size()));
    std::iota(at.begin() + first, at.end(), std::uint64_t{0});
  }
  const Buffer<std::uint64_t> order = ascending(ids);
  return {in_order(ids, order), in_order(parts, order), in_order(at, order)};
}

OfMembers holders_before(Context& context, const Scene& scene, const PlacesBefore& before,
                         const Buffer<std::uint64_t>& slots, int members) {
  OfMembers mine;
  for (const std::uint64_t slot : slots) {
    if (slot >= before.id.size()) break;
    mine.id.push_back(before.id[slot]);
    mine.member.push_back(layout::rank_of_part(before.part[slot], scene.options.parts, members));
  }
  const auto ids = gather_values<particles::Id>(context.comm, std::as_const(mine.id).span());
  const auto of = gather_values<std::int32_t>(context.comm, std::as_const(mine.member).span());
  if (!context.root()) return {};
  const Buffer<std::uint64_t> order = ascending(ids);
  return {in_order(ids, order), in_order(of, order)};
}

std::vector<wire::Array> member_results(const Scene& scene, const ResultTerms& terms, int ranks,
                                        const MemberNews& news) {
  std::vector<Results> of(static_cast<std::size_t>(terms.members));
  const auto results_of = [&](std::int32_t member) -> Results& { return of[static_cast<std::size_t>(member)]; };
  const auto member_of = [&](std::int32_t part) {
    return layout::rank_of_part(part, scene.options.parts, terms.members);
  };
  const Buffer<std::uint64_t> order = order_by_id(news.inserted.id);
  const OfMembers inserted_in_order{in_order(news.inserted.id, order), in_order(news.inserted.member, order)};
  MemberFinder pushed(news.pushed), before(news.before), inserted(inserted_in_order);
  for (std::size_t k = 0; k < news.changes.id.size(); ++k) {
    const particles::Id id = news.changes.id[k];
    const std::int32_t part = news.changes.part[k];
    auto member = pushed.find(id);
    if (!member) member = inserted.find(id);
    if (!member) member = before.find(id);
    Results& mine = results_of(member.value_or(member_of(part)));
    mine.changed_id.push_back(id);
    mine.changed_part.push_back(part);
  }
  for (std::size_t k = 0; k < news.places.id.size(); ++k) {
    const std::int32_t part = news.places.part[k];
    Results& mine = results_of(member_of(part));
    mine.place_id.push_back(news.places.id[k]);
    mine.place_rank.push_back(layout::rank_of_part(part, scene.options.parts, ranks));
    mine.place_slot.push_back(news.places.slot[k]);
  }
  for (std::size_t k = 0; k < news.inserted.id.size(); ++k)
    results_of(news.inserted.member[k]).inserted_id.push_back(news.inserted.id[k]);
  std::vector<wire::Array> arrays;
  for (Results& mine : of) {
    if (terms.changes) {
      add_array(arrays, "changed_id", "<i8", mine.changed_id);
      add_array(arrays, "changed_part", "<i4", mine.changed_part);
    }
    if (terms.places) {
      add_array(arrays, "place_id", "<i8", mine.place_id);
      add_array(arrays, "place_rank", "<i4", mine.place_rank);
      add_array(arrays, "place_slot", "<u8", mine.place_slot);
    }
    if (terms.inserted) add_array(arrays, "inserted_id", "<i8", mine.inserted_id);
  }
  return arrays;
}

}  // namespace rcb::service
