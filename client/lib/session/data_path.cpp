#include "client/lib/session/data_path.hpp"

#include <algorithm>

#include <fmt/format.h>
#include <poll.h>
#include <sys/socket.h>
#include <sys/uio.h>

#include "common/wire/frame.hpp"

namespace rcb::client {
namespace {

constexpr std::size_t kFrameBytes = std::size_t{1} << 20U;
constexpr int kSendBufferBytes = 1 << 20;
constexpr int kPollMillisecondsMax = 100;  // longest delay in noticing an early answer while all sockets are full

// The axes of these rows of one (n, dims) array, axis after axis.
template <std::size_t kDims, typename T>
void gather_rows(const void* first, const Rows& rows, std::byte* out) {
  const std::size_t count = rows.count;
  const T* values = static_cast<const T*>(first);
  T* to = reinterpret_cast<T*>(out);
  for (std::size_t i = 0; i < count; ++i) {
    const T* from = values + rows[i] * kDims;
    for (std::size_t k = 0; k < kDims; ++k) to[k * count + i] = from[k];
  }
}

}  // namespace

// One rank's connection and the frame that is being sent.
struct DataPath::Link {
  std::unique_ptr<Connection> connection;
  int rank = 0;
  std::uint64_t sent = 0;  // particles of this push
  bool done = true;
  std::string head;
  Buffer<std::byte> gathered;
  std::vector<iovec> pieces;
  std::size_t piece = 0;  // the first not completely sent

  bool between_frames() const { return piece == pieces.size(); }

  void add(const void* from, std::size_t bytes) {
    if (bytes > 0) pieces.push_back({const_cast<void*>(from), bytes});  // they are only read
  }

  void next_frame(const wire::Json& slice, std::uint64_t request, const Rows& all, std::span<const Column> columns) {
    const Rows rows = all.part(sent, std::max<std::size_t>(1, kFrameBytes / particle_bytes(columns)));
    wire::Json json = slice;
    json["rank"] = rank;
    json["first"] = sent;
    json["count"] = rows.count;
    head = frame_head(std::move(json), request, columns, rows.count);
    pieces.clear();
    piece = 0;
    add(head.data(), head.size());
    add_columns(rows, columns);
    sent += rows.count;
  }

  void add_columns(const Rows& rows, std::span<const Column> columns) {
    const auto in_place = [&rows](const Column& column) { return column.in_place(rows); };
    if (!std::ranges::all_of(columns, in_place)) gather_columns(rows, columns);
    std::size_t begin = 0;
    for (const Column& column : columns) {
      const std::size_t bytes = rows.count * column.bytes;
      const std::byte* const own = in_place(column);
      add(own != nullptr ? own : gathered.data() + begin, bytes);
      begin += bytes;
    }
  }

  // One column after another; room is left for those that are sent from the caller's memory.
  void gather_columns(const Rows& rows, std::span<const Column> columns) {
    gathered.resize(rows.count * particle_bytes(columns));
    std::byte* to = gathered.data();
    const auto axes = static_cast<std::size_t>(std::ranges::count_if(columns, &Column::is_axis));
    if (interleaved(columns.first(axes))) {
      const bool single = columns[0].bytes == sizeof(float);
      if (axes == 3)
        (single ? gather_rows<3, float> : gather_rows<3, double>)(columns[0].first, rows, to);
      else
        (single ? gather_rows<2, float> : gather_rows<2, double>)(columns[0].first, rows, to);
      to += rows.count * axes * columns[0].bytes;
      columns = columns.subspan(axes);
    }
    for (const Column& column : columns) {
      if (column.in_place(rows) == nullptr) gather(column, rows, to);
      to += rows.count * column.bytes;
    }
  }
};

DataPath::DataPath(std::vector<std::unique_ptr<Connection>> links) {
  for (auto& connection : links) {
    // With the kernel's default size the sender would block far too often.
    ::setsockopt(connection->handle(), SOL_SOCKET, SO_SNDBUF, &kSendBufferBytes, sizeof kSendBufferBytes);
    links_.push_back(std::make_unique<Link>());
    links_.back()->connection = std::move(connection);
    links_.back()->rank = static_cast<int>(links_.size() - 1);
  }
}

DataPath::~DataPath() = default;

bool DataPath::stands() {
  return std::none_of(links_.begin(), links_.end(), [](const auto& link) { return link->connection->has_frame(); });
}

Connection& DataPath::connection(int rank) { return *links_[static_cast<std::size_t>(rank)]->connection; }

Status DataPath::send_some(Link& link, bool& moved) {
  const auto sent = link.connection->send_some(std::span(link.pieces).subspan(link.piece));
  if (!sent) return {sent.status().code(), fmt::format("rank {}: {}", link.rank, sent.status().message())};
  std::size_t left = *sent;
  moved = moved || left > 0;
  while (left > 0) {
    iovec& piece = link.pieces[link.piece];
    const std::size_t bytes = std::min(left, piece.iov_len);
    piece.iov_base = static_cast<std::byte*>(piece.iov_base) + bytes;
    piece.iov_len -= bytes;
    left -= bytes;
    if (piece.iov_len == 0) ++link.piece;
  }
  return {};
}

Status DataPath::send(const wire::Json& slice, std::uint64_t request, const RankRows& rows,
                      std::span<const Column> columns, const std::function<bool()>& answered,
                      const Deadline& deadline) {
  RCB_CHECK(rows.size() == links_.size(), "a connection for each rank");
  std::size_t unfinished = 0;
  for (const auto& link : links_) {
    link->sent = 0;
    link->done = rows[static_cast<std::size_t>(link->rank)].count == 0;
    unfinished += link->done ? 0U : 1U;
  }
  bool stop = false;
  std::vector<pollfd> full;
  while (unfinished > 0) {
    bool moved = false;
    full.clear();
    for (const auto& link : links_) {
      if (link->done) continue;
      const Rows& all = rows[static_cast<std::size_t>(link->rank)];
      if (link->between_frames() && !stop) link->next_frame(slice, request, all, columns);
      if (!link->between_frames())
        if (Status status = send_some(*link, moved); !status) return status;
      if (link->between_frames() && (stop || link->sent == all.count)) {
        link->done = true;
        --unfinished;
      } else if (!link->between_frames()) {
        full.push_back({link->connection->handle(), POLLOUT, 0});
      }
    }
    if (!stop && unfinished > 0) stop = answered();
    if (moved || unfinished == 0) continue;
    if (deadline.left_seconds() <= 0) return {Code::deadline_exceeded, "the ranks did not take what was sent in time"};
    ::poll(full.data(), full.size(), kPollMillisecondsMax);
  }
  return {};
}

}  // namespace rcb::client
