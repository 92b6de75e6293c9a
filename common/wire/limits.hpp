// Every limit of protocol version 2 (PROTOCOL.md lists the same).
#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>

namespace rcb::wire {

inline constexpr std::size_t kJsonBytesMax = 1U << 24U;            // of a request (part sizes of a million parts)
inline constexpr std::size_t kJsonValuesMax = (1U << 20U) + 4096;  // of a request; each value takes memory
inline constexpr std::size_t kReplyJsonBytesMax = 1U << 23U;       // of a reply; the next two limits keep it below this
inline constexpr std::size_t kListedMax = 8192;                    // parts in a list of a reply's JSON, or in a page
inline constexpr std::size_t kReportsMax = 4096;                   // step reports in a reply
inline constexpr int kJsonDepthMax = 32;
inline constexpr std::size_t kArraysMax = 16;          // in a frame
inline constexpr std::size_t kSharedStrideMax = 4096;  // bytes from row to row in shared memory
inline constexpr std::size_t kArrayDimensionsMax = 8;  // of a shape
inline constexpr std::size_t kArrayNameMax = 64;
inline constexpr std::size_t kBytesBeforeHelloMax = 4096;
inline constexpr double kHelloSecondsMax = 5;
inline constexpr double kFrameSecondsMax = 30;
inline constexpr std::size_t kBeforeHelloMax = 1024;  // connections to a listener before their hello
inline constexpr int kSeatsMax = 1024;                // of a scene
inline constexpr int kSessionsMax = 1280;
inline constexpr int kSessionsReserved = 4;  // further ones, which may only ask status, scene.list and shutdown
inline constexpr int kOrdersMax = 2048;      // unfinished orders
inline constexpr std::size_t kLargeRequest = std::size_t{64}
                                             << 10U;  // from this size of its JSON on a request is large
inline constexpr std::uint64_t kLargeRequestBytesMax = std::uint64_t{64} << 20U;  // of all unanswered large requests
inline constexpr std::int64_t kPartsMax = 1 << 20;
inline constexpr std::int64_t kPartsTotalMax = 1 << 23;  // of all scenes: each takes some 200 bytes on every rank
inline constexpr std::int64_t kParticlesMax = std::int64_t{1} << 48;
inline constexpr int kScenesMax = 1024;
inline constexpr std::int64_t kIntegerMax = std::numeric_limits<std::int64_t>::max();
inline constexpr std::int64_t kStepMax = kIntegerMax - 1;  // so that step + 1 exists
inline constexpr int kWeightScaleMost = 1300;              // either way; of the smallest double there is
inline constexpr double kDeadlineSecondsDefault = 60;
inline constexpr double kDeadlineSecondsMax = 3600;

}  // namespace rcb::wire
