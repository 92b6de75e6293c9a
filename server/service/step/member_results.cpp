#include "server/service/step/member_results.hpp"

#include <algorithm>

#include "common/layout/layout.hpp"
#include "server/service/context/collective.hpp"

namespace rcb::service {
namespace {

// The results for one member.
struct Results {
  Buffer<particles::Id> changed_id, leave_id, enter_id, place_id;
  Buffer<std::int32_t> changed_part, leave_to, enter_from, enter_part, place_rank;
  Buffer<std::uint64_t> place_slot;
  Buffer<particles::Id> inserted_id;
  Buffer<std::int32_t> inserted_part;
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

// This rank's slots that hold another particle than before the step, or one that now belongs to another member.
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

}  // namespace

void find_all(Context& context, const Scene& scene, bool places, Whereabouts& all) {
  const auto ids = gather_values<particles::Id>(context.comm, scene.particles.id.span());
  const auto parts = gather_values<std::int32_t>(context.comm, scene.part.span());
  if (!context.root()) return;
  Buffer<std::uint64_t> order(ids.size());
  if (scene.ids)
    order = order_by_id(ids);
  else  // ids are 0..n-1, so an id is its own place in the order
    for (std::size_t k = 0; k < ids.size(); ++k) order[static_cast<std::size_t>(ids[k])] = k;
  all.part = in_order(parts, order);
  if (!places) return;
  Buffer<std::uint64_t> slots(ids.size());
  std::size_t at = 0;
  for (int rank = 0; rank < context.comm.size(); ++rank) {
    const std::uint64_t count = held_by(scene, scene.n, rank, context.comm.size());
    for (std::uint64_t slot = 0; slot < count; ++slot) slots[at++] = slot;
  }
  all.slot = in_order(slots, order);
}

Whereabouts held_by_all(Context& context, const Scene& scene, int members, const Whereabouts& pushed) {
  const auto ids = gather_values<particles::Id>(context.comm, scene.particles.id.span());
  const auto parts = gather_values<std::int32_t>(context.comm, scene.part.span());
  Whereabouts all;
  if (!context.root()) return all;
  all.id.reserve(ids.size());
  all.member.reserve(ids.size());
  std::size_t p = 0;
  for (const std::uint64_t k : order_by_id(ids)) {
    while (p < pushed.id.size() && pushed.id[p] < ids[k]) ++p;
    const bool named = p < pushed.id.size() && pushed.id[p] == ids[k];
    all.id.push_back(ids[k]);
    all.member.push_back(named ? pushed.member[p] : layout::rank_of_part(parts[k], scene.options.parts, members));
  }
  return all;
}

Whereabouts find_changed(Context& context, const Scene& scene, const PlacesBefore& before, int members,
                         const InsertedByMembers& inserted) {
  Buffer<particles::Id> id_before, id_now;
  Buffer<std::int32_t> member_before, part_now;
  Buffer<std::uint64_t> slot_now;
  for (const std::uint64_t slot : changed_slots(scene, before, members)) {
    if (slot < before.id.size()) {
      id_before.push_back(before.id[slot]);
      member_before.push_back(layout::rank_of_part(before.part[slot], scene.options.parts, members));
    }
    if (slot < scene.part.size()) {
      id_now.push_back(scene.particles.id[slot]);
      part_now.push_back(scene.part[slot]);
      slot_now.push_back(slot);
    }
  }
  Whereabouts changed;
  const auto from = gather_values<particles::Id>(context.comm, id_before.span());
  const auto member = gather_values<std::int32_t>(context.comm, member_before.span());
  const auto to = gather_values<particles::Id>(context.comm, id_now.span());
  const auto part = gather_values<std::int32_t>(context.comm, part_now.span());
  const auto slot = gather_values<std::uint64_t>(context.comm, slot_now.span());
  if (!context.root()) return changed;
  const Buffer<std::uint64_t> order_before = order_by_id(from);
  const Buffer<std::uint64_t> order_now = order_by_id(to);
  const Buffer<std::uint64_t> order_inserted = order_by_id(inserted.id);
  changed.id = in_order(to, order_now);
  // A particle that is not there any more was removed, one that was not there before was inserted.
  std::size_t b = 0;
  std::size_t i = 0;
  for (const particles::Id id : changed.id) {
    while (b < from.size() && from[order_before[b]] < id) ++b;
    while (i < inserted.id.size() && inserted.id[order_inserted[i]] < id) ++i;
    const bool was = b < from.size() && from[order_before[b]] == id;
    RCB_CHECK(was || (i < inserted.id.size() && inserted.id[order_inserted[i]] == id), "a particle came from nowhere");
    changed.member.push_back(was ? member[order_before[b]] : inserted.member[order_inserted[i]]);
  }
  changed.part = in_order(part, order_now);
  changed.slot = in_order(slot, order_now);
  return changed;
}

std::vector<wire::Array> member_results(const Scene& scene, const ResultTerms& terms, int ranks,
                                        const Whereabouts& known, const PartChanges& changes,
                                        const InsertedByMembers& inserted) {
  std::vector<Results> of(static_cast<std::size_t>(terms.members));
  const auto member_of = [&](std::int32_t part) {
    return layout::rank_of_part(part, scene.options.parts, terms.members);
  };
  std::size_t place = 0;
  for (std::size_t k = 0; k < changes.id.size(); ++k) {
    while (place < known.id.size() && known.id[place] < changes.id[k]) ++place;
    // A particle not in `known` has kept its member, which is that of its new part.
    const bool is_known = place < known.id.size() && known.id[place] == changes.id[k];
    Results& mine = of[static_cast<std::size_t>(is_known ? known.member[place] : member_of(changes.part[k]))];
    mine.changed_id.push_back(changes.id[k]);
    mine.changed_part.push_back(changes.part[k]);
  }
  for (std::size_t k = 0; k < known.part.size(); ++k) {  // the results of terms.follow and terms.places
    const int from = known.member[k];
    const int to = member_of(known.part[k]);
    Results& winner = of[static_cast<std::size_t>(to)];
    if (terms.places) {
      winner.place_id.push_back(known.id[k]);
      winner.place_rank.push_back(layout::rank_of_part(known.part[k], scene.options.parts, ranks));
      winner.place_slot.push_back(known.slot[k]);
    }
    if (from == to) continue;
    Results& loser = of[static_cast<std::size_t>(from)];
    loser.leave_id.push_back(known.id[k]);
    loser.leave_to.push_back(to);
    winner.enter_id.push_back(known.id[k]);
    winner.enter_from.push_back(from);
    winner.enter_part.push_back(known.part[k]);
  }
  for (std::size_t k = 0; k < inserted.id.size(); ++k) {
    Results& mine = of[static_cast<std::size_t>(inserted.member[k])];
    const auto found = std::lower_bound(known.id.begin(), known.id.end(), inserted.id[k]) - known.id.begin();
    mine.inserted_id.push_back(inserted.id[k]);
    mine.inserted_part.push_back(inserted.part.empty() ? known.part[static_cast<std::size_t>(found)]
                                                       : inserted.part[k]);
  }
  std::vector<wire::Array> arrays;
  for (Results& mine : of) {
    if (terms.changes) {
      add_array(arrays, "changed_id", "<i8", mine.changed_id);
      add_array(arrays, "changed_part", "<i4", mine.changed_part);
    }
    if (terms.follow) {
      add_array(arrays, "leave_id", "<i8", mine.leave_id);
      add_array(arrays, "leave_to", "<i4", mine.leave_to);
      add_array(arrays, "enter_id", "<i8", mine.enter_id);
      add_array(arrays, "enter_from", "<i4", mine.enter_from);
      add_array(arrays, "enter_part", "<i4", mine.enter_part);
    }
    if (terms.places) {
      add_array(arrays, "place_id", "<i8", mine.place_id);
      add_array(arrays, "place_rank", "<i4", mine.place_rank);
      add_array(arrays, "place_slot", "<u8", mine.place_slot);
    }
    if (terms.inserted) {
      add_array(arrays, "inserted_id", "<i8", mine.inserted_id);
      add_array(arrays, "inserted_part", "<i4", mine.inserted_part);
    }
  }
  return arrays;
}

}  // namespace rcb::service
