// Cuts as a service tells them: x = 1, 2, ... for parts in order.
#pragma once

#include <cstdint>
#include <vector>

#include "common/cuts/cut_arrays.hpp"
#include "tests/support/protocol.hpp"

namespace rcb::client {

struct ToldCuts {
  protocol::Json json;
  std::vector<protocol::Array> arrays;

  ToldCuts(int dims, int parts, std::int64_t epoch) {
    cuts::CutArrays told{.dims = dims, .parts = parts};
    add(told, 0, parts);
    const std::uint64_t hash = cuts::tree_of(told).value().hash();
    json = {{"epoch", epoch}, {"method", "rcb"}, {"dims", dims}, {"parts", parts}, {"hash", protocol::hex64(hash)}};
    arrays = {protocol::array_of("axes", "<i4", told.axes), protocol::array_of("at", "<f8", told.at),
              protocol::array_of("id", "<i8", told.id)};
  }
  // To the answer to a push.
  void add_unless_known(const protocol::Json& known, protocol::Json& answer, std::vector<protocol::Array>& into) const {
    if (known.value("epoch", -1) == json["epoch"] && known.value("hash", "") == json["hash"]) return;
    answer["cuts"] = json;
    into.insert(into.end(), arrays.begin(), arrays.end());
  }

 private:
  // In preorder.
  static void add(cuts::CutArrays& to, int first, int last) {
    if (last - first < 2) return;
    const int middle = first + (last - first + 1) / 2;
    for (int a = 0; a < to.dims; ++a) {
      to.axes.push_back(a);
      to.at.push_back(a == 0 ? middle : 0);
    }
    to.id.push_back(0);
    add(to, first, middle);
    add(to, middle, last);
  }
};

}  // namespace rcb::client
