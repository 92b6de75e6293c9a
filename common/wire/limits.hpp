// Every limit of protocol version 1 (PROTOCOL.md lists the same).
#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>

namespace rcb::wire {

inline constexpr std::size_t kJsonBytesMax = 1U << 24U;            // of a request (part sizes of a million parts)
inline constexpr std::size_t kJsonValuesMax = (1U << 20U) + 4096;  // of a request, each of which takes memory
inline constexpr std::size_t kReplyJsonBytesMax = 1U << 23U;       // of a reply: what follows keeps every one below it
inline constexpr std::size_t kListedMax = 8192;                    // parts of a list in a reply's JSON, or in a page
inline constexpr std::size_t kReportsMax = 4096;                   // step reports in a reply
inline constexpr int kJsonDepthMax = 32;
inline constexpr std::size_t kArraysMax = 16;          // in a frame
inline constexpr std::size_t kArrayDimensionsMax = 8;  // of a shape
inline constexpr std::size_t kArrayNameMax = 64;
inline constexpr std::size_t kBytesBeforeHelloMax = 4096;
inline constexpr double kHelloSecondsMax = 5;
inline constexpr double kFrameSecondsMax = 30;
inline constexpr std::size_t kNewcomersMax = 64;  // connections to a listener that haven't said hello
inline constexpr int kSessionsMax = 256;
inline constexpr int kSessionsReserved = 4;  // beyond them, for status, scene.list and shutdown alone
inline constexpr int kOrdersMax = 512;       // unfinished ones, and of their requests
inline constexpr std::uint64_t kOrderBytesMax = std::uint64_t{256} << 20U;
inline constexpr std::int64_t kPartsMax = 1 << 20;
inline constexpr std::int64_t kPartsTotalMax = 1 << 23;  // of all scenes: some 200 bytes each on every rank
inline constexpr std::int64_t kParticlesMax = std::int64_t{1} << 48;
inline constexpr int kScenesMax = 1024;
inline constexpr std::int64_t kStepMax = std::numeric_limits<std::int64_t>::max() - 1;  // so that there is a next one
// Instead of a rank, in slices of particles that have none yet or no more.
inline constexpr int kInsertedSlice = -1;
inline constexpr int kRemovedSlice = -2;
inline constexpr double kDeadlineSecondsDefault = 60;
inline constexpr double kDeadlineSecondsMax = 3600;

}  // namespace rcb::wire
