#include "server/net/data/incoming_slices.hpp"

#include <utility>

#include <fmt/format.h>

#include "common/base/axis_names.hpp"

namespace rcb::net {
namespace {

constexpr std::size_t kEndedMax = 16384;  // number of ended pushes that are remembered

}  // namespace

void IncomingSlices::end(const std::shared_ptr<Incoming>& push, const Status& status) {
  if (std::exchange(push->over, true)) return;
  const std::uint64_t bytes = push->arrays.size() * push->ticket.terms.n * 8;
  if (!status.ok()) push->arrays.clear();
  report_({push->ticket.number, bytes, status.ok(), status});
}

void IncomingSlices::tell(Incoming& push, std::uint64_t more) {
  if (push.over || push.connection == nullptr) return;
  const std::uint64_t bytes = push.connection->bytes_received() - push.connection_bytes;
  if (bytes < push.told_bytes + more) return;
  push.told_bytes = bytes;
  report_({push.ticket.number, bytes, false, {}});
}

void IncomingSlices::tell_all() {
  for (const auto& [number, push] : pushes_) tell(*push, 1);
}

void IncomingSlices::remember_ended(const PushId& id) {
  if (!ended_.insert(id).second) return;
  ended_in_turn_.push_back(id);
  if (ended_in_turn_.size() <= kEndedMax) return;
  ended_.erase(ended_in_turn_.front());
  ended_in_turn_.pop_front();
}

std::shared_ptr<Incoming> IncomingSlices::find(const PushId& id) const {
  const auto found = numbers_.find(id);
  return found == numbers_.end() ? nullptr : pushes_.at(found->second);
}

void IncomingSlices::lose(const Connection& connection, const std::string& why) {
  std::vector<std::shared_ptr<Incoming>> lost;
  for (const auto& [number, push] : pushes_)
    if (push->connection == &connection && !push->over) lost.push_back(push);
  for (const auto& push : lost)
    end(push, {Code::aborted,
               fmt::format("the data connection to rank {} was lost after {} of {} particles{}{}", rank_, push->have,
                           push->ticket.terms.n, why.empty() ? "" : ": ", why),
               "the previous step stands; push again"});
}

void IncomingSlices::open(PushTicket ticket) {
  auto push = std::make_shared<Incoming>();
  push->ticket = std::move(ticket);
  const PushTerms& terms = push->ticket.terms;
  const std::size_t arrays = static_cast<std::size_t>(terms.dims) + (terms.weights ? 1U : 0U) + (terms.ids ? 1U : 0U);
  bool fits = true;
  for (std::size_t a = 0; a < arrays && fits; ++a) {
    Buffer<std::byte> buffer = spare_->take(terms.id.scene);
    // Reserves room for some arrivals, which costs address space only: if a slice outgrew its buffer by a few
    // particles, the kernel would have to clear new pages for all of it.
    fits = buffer.capacity() >= terms.n * 8 || buffer.try_reserve((terms.n + terms.n / 16) * 8);
    if (fits) buffer.resize(terms.n * 8);
    push->arrays.push_back(std::move(buffer));
  }
  ended_.erase(terms.id);  // the client repeats an attempt that had ended
  pushes_[push->ticket.number] = push;
  numbers_[terms.id] = push->ticket.number;
  if (!fits)
    end(push, {Code::too_large, fmt::format("rank {} has no memory for {} particles", rank_, push->ticket.terms.n)});
  else if (terms.n == 0)
    end(push, {});
}

void IncomingSlices::drop(const PushId& id) {
  if (const auto push = find(id)) {
    push->over = true;
    push->arrays.clear();
    forget(*push);
  }
  remember_ended(id);
}

void IncomingSlices::forget(const Incoming& push) {
  pushes_.erase(push.ticket.number);
  if (const auto named = numbers_.find(push.ticket.terms.id);
      named != numbers_.end() && named->second == push.ticket.number)
    numbers_.erase(named);
}

std::optional<Slice> IncomingSlices::take(std::uint64_t number) {
  const auto found = pushes_.find(number);
  if (found == pushes_.end()) return std::nullopt;
  const std::shared_ptr<Incoming> push = found->second;
  forget(*push);
  const PushTerms& terms = push->ticket.terms;
  remember_ended(terms.id);
  if (push->have != terms.n) return std::nullopt;
  Slice slice{.count = terms.n};
  for (std::size_t a = 0; a < push->arrays.size(); ++a) {
    const bool axis = a < static_cast<std::size_t>(terms.dims);
    const bool weight = !axis && terms.weights && a == static_cast<std::size_t>(terms.dims);
    const char* name = axis ? kAxisNames[a] : weight ? "w" : "id";
    slice.arrays.push_back({name, axis || weight ? "<f8" : "<i8", {terms.n}, std::move(push->arrays[a])});
  }
  return slice;
}

}  // namespace rcb::net
