#include "server/service/cuts_json.hpp"

#include <cmath>

namespace rcb::service {
namespace {

using partition::Cut;
using partition::CutTree;
using partition::NodeRange;

wire::Json child_json(const NodeRange& child) {
  if (child.leaf()) return {{"part", child.first}};
  return {{"node", child.node}};
}

wire::Json ties_json(const Cut& cut, int dims) {
  wire::Json axes = wire::Json::array();
  wire::Json at = wire::Json::array();
  for (std::size_t i = 1; i < static_cast<std::size_t>(dims); ++i) {
    axes.push_back(cut.axes[i]);
    at.push_back(cut.key.at[i]);
  }
  return {{"axes", std::move(axes)}, {"at", std::move(at)}, {"id", cut.key.id}};
}

void append_cuts(const CutTree& tree, const NodeRange& range, wire::Json& out) {
  if (range.leaf()) return;
  const Cut& cut = tree.cuts[static_cast<std::size_t>(range.node)];
  out.push_back({{"node", range.node},
                 {"axis", cut.axes[0]},
                 {"at", cut.right_empty ? wire::Json(nullptr) : wire::Json(cut.key.at[0])},
                 {"ties", cut.right_empty ? wire::Json(nullptr) : ties_json(cut, tree.dims)},
                 {"left", child_json(range.left())},
                 {"right", child_json(range.right())}});
  append_cuts(tree, range.left(), out);
  append_cuts(tree, range.right(), out);
}

wire::Json bound_json(double bound) { return std::isfinite(bound) ? wire::Json(bound) : wire::Json(nullptr); }

}  // namespace

wire::Json cuts_json(const CutTree& tree, std::uint64_t epoch) {
  wire::Json cuts = wire::Json::array();
  append_cuts(tree, tree.root(), cuts);
  wire::Json regions = wire::Json::array();
  const auto boxes = tree.regions();
  for (std::size_t p = 0; p < boxes.size(); ++p) {
    wire::Json lo = wire::Json::array();
    wire::Json hi = wire::Json::array();
    const bool empty = boxes[p].empty(tree.dims);
    for (std::size_t a = 0; a < static_cast<std::size_t>(tree.dims); ++a) {
      lo.push_back(empty ? wire::Json(nullptr) : bound_json(boxes[p].lo[a]));
      hi.push_back(empty ? wire::Json(nullptr) : bound_json(boxes[p].hi[a]));
    }
    wire::Json region{{"part", p}, {"lo", std::move(lo)}, {"hi", std::move(hi)}};
    if (empty) region["empty"] = true;
    regions.push_back(std::move(region));
  }
  return {{"epoch", epoch},
          {"method", partition::method_name(tree.method)},
          {"parts", tree.parts},
          {"cuts", std::move(cuts)},
          {"regions", std::move(regions)},
          {"hash", wire::hex64(tree.hash())}};
}

}  // namespace rcb::service
