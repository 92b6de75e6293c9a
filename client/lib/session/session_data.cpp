// Session, part 2: the connections to the ranks themselves, memory shared over them, and pushes that go there.
#include <algorithm>
#include <utility>

#include <fmt/format.h>

#include "client/lib/session/data_path.hpp"
#include "client/lib/session/session.hpp"

namespace rcb::client {
namespace {

constexpr double kLookSeconds = 0.25;  // at the connections, while an answer is awaited

}  // namespace

Status Session::open_data(const Deadline& deadline) {
  std::vector<std::unique_ptr<Connection>> links;
  for (std::size_t rank = 0; rank < data_addresses_.size(); ++rank) {
    auto link = open_link(rank, deadline);
    if (!link) return link.status();
    links.push_back(std::move(*link));
  }
  data_ = std::make_unique<DataPath>(std::move(links));
  ++data_generation_;
  return {};
}

Result<std::unique_ptr<Connection>> Session::open_link(std::size_t rank, const Deadline& deadline) {
  const bool is_local = !local_addresses_[rank].empty();
  auto endpoint = parse_endpoint(is_local ? local_addresses_[rank] : data_addresses_[rank]);
  if (!endpoint) return endpoint.status();
  // A listener on all interfaces is reached at the host where the endpoint was found.
  if (!endpoint->is_unix && (endpoint->host == "0.0.0.0" || endpoint->host == "::"))
    endpoint->host = endpoints_.front().host;
  auto link = Connection::open(*endpoint, deadline, options_.on_notice, options_.on_wait);
  Status status = link.status();
  if (status) status = greet(*link, *endpoint, fmt::format("rank {}", rank), deadline).status();
  if (status) return link;
  if (!is_local || local_addresses_[rank] == data_addresses_[rank]) return status;
  local_addresses_[rank].clear();  // another user's, for one
  return open_link(rank, deadline);
}

DataPath* Session::data(const Deadline& deadline) {
  if (data_ && !data_->stands()) give_up_data();
  if (!data_ && !data_tried_ && data_addresses_.size() == static_cast<std::size_t>(ranks_)) {
    data_tried_ = true;
    static_cast<void>(open_data(deadline.within(options_.deadline_seconds)));
  }
  return data_.get();
}

bool Session::can_share(const Deadline& deadline) {
  const auto any_here = [this] { return ranks_apart().size() < static_cast<std::size_t>(ranks_); };
  return any_here() && !share_refused_ && data(deadline) != nullptr && any_here();
}

bool Session::shares_with(int rank) const {
  const auto r = static_cast<std::size_t>(rank);
  return r < local_addresses_.size() && !local_addresses_[r].empty();
}

std::vector<int> Session::ranks_apart() const {
  std::vector<int> apart;
  for (int rank = 0; rank < ranks_; ++rank)
    if (!shares_with(rank)) apart.push_back(rank);
  return apart;
}

Status Session::share(const SharedMemory& memory, std::int64_t number, const Deadline& deadline) {
  return ask_ranks({{"command", "memory.share"}, {"memory", number}, {"bytes", memory.size()}}, memory.descriptor(),
                   deadline);
}

void Session::unshare(std::int64_t number, const Deadline& deadline) {
  static_cast<void>(ask_ranks({{"command", "memory.drop"}, {"memory", number}}, -1, deadline));
}

Status Session::ask_ranks(const wire::Json& request, int descriptor, const Deadline& deadline) {
  if (!data_) return {Code::aborted, "the connections to the ranks were lost"};
  std::vector<std::pair<int, std::uint64_t>> requests;
  Status lost, refused;
  for (int rank = 0; rank < ranks_ && lost; ++rank) {
    if (!shares_with(rank)) continue;
    const std::string frame = request_frame(requests.emplace_back(rank, next_request()).second, request);
    lost = data_->connection(rank).send_at_once(std::as_bytes(std::span(frame)), descriptor);
  }
  for (std::size_t k = 0; k < requests.size() && lost; ++k) {
    Connection& link = data_->connection(requests[k].first);
    const Status answer = await_answer(link, requests[k].second, deadline).status();
    if (!answer && !link.lost())
      lost = answer;
    else if (!answer && refused)
      refused = answer;
  }
  if (!lost) {
    give_up_data();
    return {Code::aborted, lost.message(), lost.hint()};
  }
  if (refused || refused.code() == Code::too_large) return refused;
  return {Code::unsupported, refused.message(), refused.hint()};
}

Status Session::no_data() {
  if (data_addresses_.size() != static_cast<std::size_t>(ranks_))
    return {Code::unavailable, fmt::format("{} has no direct path to its ranks", endpoint_text_),
            "leave the path to the library, or start the service without --gateway-only"};
  connection_.reset();
  return {Code::unavailable, fmt::format("a rank of the service at {} doesn't answer", endpoint_text_),
          "leave the path to the library, or see rcbctl status"};
}

void Session::give_up_data() {
  data_.reset();
  data_tried_ = ++data_failures_ > 1 && options_.path != Path::direct;
}

Result<Frame> Session::exchange_directly(std::uint64_t request, const wire::Json& push, const RankRows& rows,
                                         std::span<const Column> columns, const std::string& what,
                                         const Deadline& deadline) {
  if (!connection_) return lost_connection();
  // Lost when memory was taken back from the ranks, for one.
  if (data_ == nullptr) return Status(Code::aborted, "the connections to the ranks were lost");
  if (connection_->write(request_frame(request, push), deadline)) {
    const auto answered = [this] { return connection_->has_frame(); };
    const Status sent = data_->send(slice_json(push), request, rows, columns, answered, deadline);
    if (!sent) {
      give_up_data();
      return Status(Code::aborted, sent.message(), sent.hint());
    }
  }
  // A slice that was on a lost connection is missed by nobody else: the rank can't know whose it was.
  while (!connection_->await_frame(deadline.within(kLookSeconds)) && deadline.left_seconds() > 0)
    if (!data_->stands()) {
      give_up_data();
      return Status(Code::aborted, "a connection to a rank was lost");
    }
  auto answer = await_answer_to(request, what, deadline);
  if (answer) data_failures_ = 0;
  // Perhaps the network has forgotten a connection without a word.
  if (answer.status().code() == Code::deadline_exceeded) give_up_data();
  return answer;
}

}  // namespace rcb::client
