// Partitions a distributed particle set into P parts: exact RCB, bands (a tree with one axis order), or a baseline to
// compare with. Particles stay where they are; the result names each local particle's part.
//
// Source: Berger and Bokhari 1987, doi:10.1109/TC.1987.1676942 (recursive bisection).
#pragma once

#include "common/base/status.hpp"
#include "common/comm/comm.hpp"
#include "common/partition/rules/request.hpp"

namespace rcb::partition {

// Collective. All ranks pass the same options; positions are finite and ids unique (the caller has checked).
//   particles  this rank's; any distribution over the ranks gives the same tree, bit for bit
//   go_on      called between the levels of the tree
// Errors: invalid_argument (the same on every rank): parts < 1, bad sizes, dims against method; aborted if go_on says
// no.
//
// The baselines: equal_boxes cuts at the middle of each box (a coordinate equal to the middle goes right). file_order
// returns only `part` (blocks in ascending id by the quotas, weights ignored) and a default tree.
Result<PartitionResult> partition(comm::Comm& comm, const particles::ParticleView& particles,
                                  const PartitionOptions& options, const comm::GoOn& go_on = {});

}  // namespace rcb::partition
