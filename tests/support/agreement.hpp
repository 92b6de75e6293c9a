// A partition against the judge: every cut bit for bit, every particle, and what asks the tree about them.
#pragma once

#include <string>

#include "common/partition/partition.hpp"
#include "tests/support/judge.hpp"
#include "tests/support/scenes.hpp"

namespace rcb::testing {

partition::PartitionOptions options_of(const JudgeOptions& asked);

// What this rank sees wrong in `got`, the partition of `share`; empty: nothing. Local, so ranks may see different
// things.
std::string disagreement(const partition::PartitionResult& got, const Share& share, const Judgement& judged);

}  // namespace rcb::testing
