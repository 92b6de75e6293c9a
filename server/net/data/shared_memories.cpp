#include "server/net/data/shared_memories.hpp"

#include <algorithm>

#include <fmt/format.h>

#include "common/wire/field_reader.hpp"
#include "common/wire/limits.hpp"
#include "server/net/sockets/hello.hpp"

namespace rcb::net {
namespace {

constexpr std::ptrdiff_t kMemoriesMax = 256;        // that a connection brings
constexpr std::size_t kAllMemoriesMax = 4096;       // of all connections: a process has a limited number of mappings,
constexpr std::uint64_t kAllMemoriesBytesMax = 16;  // and of addresses; in multiples of the limit of one push

}  // namespace

Status SharedMemories::take_frame(Connection& connection, const Frame& frame, const std::string& session, bool share) {
  if (frame.header.bulk_bytes > 0) return {Code::protocol_error, "shared memory comes without arrays"};
  wire::FieldReader fields(frame.json);
  const Key key(session, fields.integer("memory", 0, wire::kIntegerMax));
  const auto bytes = static_cast<std::uint64_t>(share ? fields.integer("bytes", 1, wire::kIntegerMax) : 0);
  Status status = fields.status();
  Descriptor descriptor = share ? connection.take_descriptor() : Descriptor();  // also where the frame is refused
  if (status.ok() && share) status = this->share(key, bytes, std::move(descriptor), connection);
  if (!share) drop(key, connection);
  if (status.ok())
    connection.send(wire::FrameType::reply, frame.header.request, {{"memory", key.second}});
  else
    connection.send(wire::FrameType::failure, frame.header.request, wire::failure_json(status));
  return {};
}

Status SharedMemories::share(const Key& key, std::uint64_t size, Descriptor descriptor, const Connection& connection) {
  const auto others = std::count_if(memories_.begin(), memories_.end(), [&](const auto& entry) {
    return entry.second.connection == &connection && entry.first != key;
  });
  if (others >= kMemoriesMax)
    return {Code::too_large, fmt::format("a connection shares {} memories at most", kMemoriesMax)};
  if (size > bytes_max_)
    return {Code::too_large, fmt::format("{} bytes are shared, at most {} are taken", size, bytes_max_)};
  if (!descriptor.open())
    return {Code::invalid_argument, "no descriptor came with memory.share",
            "send it with the frame, over the rank's Unix socket (SCM_RIGHTS)"};
  if (memories_.size() >= kAllMemoriesMax || bytes() + size > kAllMemoriesBytesMax * bytes_max_)
    return {Code::busy,
            fmt::format("{} memories of {} bytes are shared with rank {}, which is about the most", memories_.size(),
                        bytes(), rank_),
            "push through a socket"};
  auto mapped = SharedMemory::map(std::move(descriptor), size);
  if (!mapped.ok()) return mapped.status();
  const auto found = memories_.find(key);
  const bool known = found != memories_.end() && found->second.connection == &connection;
  if (known && !found->second.memory->same_as(*mapped))
    return {Code::already_exists, fmt::format("memory {} is another one", key.second), "take a new number"};
  if (const auto last = last_dropped_.find(&connection);
      !known && last != last_dropped_.end() && key.second <= last->second)
    return {Code::invalid_argument,
            fmt::format("memory {} can't be shared after {} was dropped", key.second, last->second),
            "take a greater number"};
  memories_[key] = {std::make_shared<const SharedMemory>(std::move(*mapped)), &connection};
  return {};
}

void SharedMemories::drop(const Key& key, const Connection& connection) {
  const auto found = memories_.find(key);
  if (found == memories_.end() || found->second.connection != &connection) return;
  memories_.erase(found);
  std::int64_t& last = last_dropped_[&connection];
  last = std::max(last, key.second);
}

std::uint64_t SharedMemories::bytes() const {
  std::uint64_t bytes = 0;
  for (const auto& [key, shared] : memories_) bytes += shared.memory->size();
  return bytes;
}

void SharedMemories::forget(const Connection& connection) {
  std::erase_if(memories_, [&](const auto& entry) { return entry.second.connection == &connection; });
  last_dropped_.erase(&connection);
}

std::shared_ptr<const SharedMemory> SharedMemories::find(const std::string& session, std::int64_t number) const {
  const auto found = memories_.find({session, number});
  return found == memories_.end() ? nullptr : found->second.memory;
}

}  // namespace rcb::net
