// A push: which way the rows of a step take to the ranks, and which rank each of them goes to first.
#include <algorithm>
#include <numeric>

#include <fmt/format.h>

#include "client/lib/scene/scene.hpp"
#include "client/lib/session/data_path.hpp"
#include "client/lib/session/push_source.hpp"
#include "common/layout/layout.hpp"

namespace rcb::client {

bool Scene::State::by_shared_memory(const StepRequest& ask, const Retry& retry) const {
  const Path path = session().path();
  if (path != Path::automatic && path != Path::shared) return false;
  // Ranks on other hosts get their rows over sockets. It is worth while if few positions are copied for nothing.
  const auto worth_while = [&] {
    const std::size_t apart = session().ranks_apart().size();
    const bool few_copies = arrays_.gave(columns_of(ask.positions, {}, {}), ask.positions.count) ||
                            2 * apart <= static_cast<std::size_t>(session().ranks());
    return apart == 0 || path == Path::shared || (ask.large() && few_copies);
  };
  // Where the connections to the ranks are opened it may turn out that more of them are apart.
  return worth_while() && session().can_share(retry.deadline()) && worth_while();
}

Result<Scene::State::Way> Scene::State::choose_way(const StepRequest& ask, const Retry& retry) const {
  if (ask.positions.count == 0) return Way::endpoint;
  if (by_shared_memory(ask, retry)) {
    const bool rows_are_ids = ask.options.ids.empty() && !has_ids_ && !seated() && !ask.flows();
    return rows_are_ids && session().ranks_apart().empty() ? Way::held : Way::shared;
  }
  const Path path = session().path();
  if (path == Path::gateway || (path != Path::direct && !ask.large())) return Way::endpoint;
  if (session().data(retry.deadline()) != nullptr) return Way::sockets;
  if (path != Path::direct) return Way::endpoint;
  return session().no_data();
}

RankRows Scene::State::rows_by_rank(const StepRequest& ask, bool grouped, std::span<std::uint64_t> list) const {
  const std::size_t count = ask.positions.count;
  const int ranks = session().ranks();
  RankRows rows;
  if (!grouped) {
    std::iota(list.begin(), list.end(), 0);
    for (int rank = 0; rank < ranks; ++rank) {
      const std::uint64_t first = layout::row_begin(rank, count, ranks);
      rows.push_back({nullptr, first, layout::row_begin(rank + 1, count, ranks) - first});
    }
    return rows;
  }
  const int parts = cuts_.known->parts();
  std::vector<std::size_t> rank_of;                                        // by part
  std::vector<std::uint64_t> end(static_cast<std::size_t>(ranks) + 1, 0);  // of a rank's rows in the list; a 0 before
  for (int part = 0; part < parts; ++part) {
    rank_of.push_back(static_cast<std::size_t>(layout::rank_of_part(part, parts, ranks)));
    end[rank_of.back() + 1] += counted_.counts()[rank_of.size() - 1];
  }
  std::partial_sum(end.begin(), end.end(), end.begin());
  std::vector<std::uint64_t> next(end.begin(), end.end() - 1);
  const auto part = counted_.parts();
  for (std::size_t row = 0; row < count; ++row) list[next[rank_of[static_cast<std::size_t>(part[row])]]++] = row;
  for (std::size_t rank = 0; rank < next.size(); ++rank)
    rows.push_back(Rows::of(list.subspan(end[rank], next[rank] - end[rank])));
  return rows;
}

wire::Json Scene::State::push_json(std::int64_t step, const Retry& retry) const {
  wire::Json push{{"command", "push"},
                  {"scene", name_},
                  {"step", step},
                  {"attempt", session().next_attempt()},
                  {"n", 0},
                  {"cuts_known", cuts_.known_json()},
                  {"deadline_seconds", retry.seconds_left()}};
  if (!incarnation_.empty()) push["incarnation"] = incarnation_;
  return push;
}

std::span<const std::int64_t> Scene::State::row_numbers(std::size_t count) {
  if (const std::size_t known = numbers_.size(); known < count) {
    numbers_.resize(count);
    std::iota(numbers_.begin() + known, numbers_.end(), static_cast<std::int64_t>(known));
  }
  return numbers_.span().first(count);
}

Result<Frame> Scene::State::push(const StepRequest& ask, std::int64_t step, const Retry& retry) {
  const auto way = choose_way(ask, retry);
  if (!way) return way.status();
  way_ = *way;
  const std::size_t count = ask.positions.count;
  const bool to_ranks = way_ == Way::sockets || way_ == Way::shared;
  // A wrong value is told by the ranks: also to the others, if there are any.
  const bool classified = (way_ != Way::held || ask.wants()) && cuts_.known &&
                          counted_.find_parts(*cuts_.known, rows_of(ask), last_step_).ok();
  const bool grouped = to_ranks && classified;
  Values values{weights_of(ask), ask.options.ids};
  if (way_ == Way::held && filled_ && !when_needed_) values.weights = ask.options.weights;  // the ranks have the others
  // A rank numbers rows without ids as they come over its socket, or by the list in memory. Where neither tells the
  // row, ids do: rows that were grouped by rank go over sockets, or some ranks read memory and others a socket.
  const bool some_apart = way_ == Way::shared && !session().ranks_apart().empty();
  if (values.ids.empty() && (some_apart || (way_ == Way::sockets && grouped))) values.ids = row_numbers(count);
  wire::Json push = push_json(step, retry);
  push.update({{"n", count},
               {"dtype", ask.positions.single() ? "<f4" : "<f8"},
               {"weights", !values.weights.empty()},
               {"ids", !values.ids.empty()},
               {"inserted", ask.options.inserted},
               {"removed", ask.options.removed}});
  if (ask.options.step_seconds) push["step_seconds"] = *ask.options.step_seconds;
  if (const auto drifted = counted_.drifted(); drifted && last_step_) push["drifted"] = *drifted;
  if (!to_ranks) return send(std::move(push), ask, {}, values, retry);
  std::span<std::uint64_t> list;
  if (way_ == Way::shared) {
    const auto room = arrays_.row_list(count);
    if (!room) return room.status();
    list = *room;
  } else if (grouped) {
    list_.resize(count);
    list = list_.span();
  }
  RankRows rows = rows_by_rank(ask, grouped, list);
  for (const Rows& of_rank : rows) push["counts"].push_back(of_rank.count);
  return send(std::move(push), ask, std::move(rows), values, retry);
}

Result<Frame> Scene::State::send(wire::Json push, const StepRequest& ask, RankRows rows, const Values& values,
                                 const Retry& retry) {
  const Deadline& deadline = retry.deadline();
  const std::string what = fmt::format("push of step {} to scene '{}'", push["step"].get<std::int64_t>(), name_);
  const std::uint64_t request = session().next_request();
  const std::size_t count = ask.positions.count;
  const auto columns = columns_of(ask.positions, values.weights, values.ids);
  if (way_ == Way::endpoint) {
    push["way"] = "endpoint";
    PushSource source(push, request, count, columns);
    return session().exchange(request, source, what, deadline);
  }
  if (way_ == Way::sockets) {
    push["way"] = "sockets";
    return session().exchange_directly(request, push, rows, columns, what, deadline);
  }
  auto memory = arrays_.describe(session(), columns, count, way_ == Way::shared ? count : 0, deadline);
  if (!memory) return memory.status();
  push["way"] = "shared-memory";
  push["memory"] = std::move(*memory);
  const auto apart = session().ranks_apart();
  if (apart.empty()) return session().exchange_frames(request, request_frame(request, push), what, deadline);
  push["sockets"] = apart;
  for (int rank = 0; rank < session().ranks(); ++rank)
    if (session().shares_with(rank)) rows[static_cast<std::size_t>(rank)] = {};
  return session().exchange_directly(request, push, rows, columns, what, deadline);
}

}  // namespace rcb::client
