// A solver's arrays by row, as it keeps them by what the library tells after each step.
#pragma once

#include <algorithm>
#include <vector>

#include "client/lib/client.hpp"

namespace rcb::client {

struct Rows {
  std::vector<double> xyz, weights;  // no weights: empty
  std::vector<std::int64_t> ids;
  std::vector<std::int32_t> parts;

  Positions positions() const { return Positions::rows(xyz.data(), ids.size(), 3); }

  // As row_moves says; more: the inserted.
  void follow(const StepResult& result, const std::vector<double>& more, const std::vector<double>& more_weights,
              std::size_t n) {
    const Rows old = *this;
    const bool weighted = !weights.empty() || !more_weights.empty();
    resize(std::max(n, ids.size()), weighted);
    for (const RowMove& move : result.row_moves) {
      ids[move.to] = move.inserted ? result.inserted_ids[move.from] : old.ids[move.from];
      parts[move.to] = move.inserted ? -1 : old.parts[move.from];
      if (weighted) weights[move.to] = (move.inserted ? more_weights : old.weights)[move.from];
      for (std::size_t a = 0; a < 3; ++a) xyz[3 * move.to + a] = (move.inserted ? more : old.xyz)[3 * move.from + a];
    }
    resize(n, weighted);
    for (const PartChange& change : result.changes) parts.at(change.row) = change.part;
  }

 private:
  void resize(std::size_t n, bool weighted) {
    ids.resize(n);
    if (weighted) weights.resize(n);
    xyz.resize(3 * n);
    parts.resize(n, -1);
  }
};

}  // namespace rcb::client
