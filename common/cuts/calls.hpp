// What all questions about positions have in common: the check of the call, threads, and room for the answer.
#pragma once

#include <cstddef>
#include <functional>
#include <new>
#include <span>
#include <string>

#include "common/base/status.hpp"
#include "common/cuts/cut_tree.hpp"
#include "common/cuts/halo.hpp"
#include "common/cuts/positions.hpp"

namespace rcb::cuts {

// Errors of these: invalid_argument.
Status bad_call(std::string message);
Status check_call(const CutTree& tree, const Positions& positions, const OwnerOptions& options);
Status check_room(const Positions& positions, std::span<std::int32_t> part);

// In how many shares the rows are worth dividing among threads.
std::size_t shares_of(std::size_t count, int threads);
// Calls work(k, begin, end) for shares of the rows, each on a thread of its own as far as the system gives them.
// Returns the first share's error.
Status share_rows(std::size_t count, std::size_t shares,
                  const std::function<Status(std::size_t, std::size_t, std::size_t)>& work);

// What ask() returns, or the error that there was no memory for it.
template <typename Ask>
auto within_memory(const Ask& ask) -> decltype(ask()) {
  try {
    return ask();
  } catch (const std::bad_alloc&) {
    return Status(Code::too_large, "no memory for an answer of the cuts");
  }
}

}  // namespace rcb::cuts
