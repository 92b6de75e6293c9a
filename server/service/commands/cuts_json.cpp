#include "server/service/commands/cuts_json.hpp"

#include <cmath>

#include "server/api/cut_arrays.hpp"
#include "server/service/context/collective.hpp"

namespace rcb::service {
namespace {

using cuts::Cut;
using cuts::CutTree;
using cuts::NodeRange;

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

wire::Json cut_json(const CutTree& tree, const NodeRange& range) {
  const Cut& cut = tree.cuts[static_cast<std::size_t>(range.node)];
  return {{"node", range.node},
          {"axis", cut.axes[0]},
          {"at", cut.right_empty ? wire::Json(nullptr) : wire::Json(cut.key.at[0])},
          {"ties", cut.right_empty ? wire::Json(nullptr) : ties_json(cut, tree.dims)},
          {"left", child_json(range.left())},
          {"right", child_json(range.right())}};
}

// Appends the cuts of the nodes [first, last). The subtree of node v with k parts has the nodes v to v + k - 2.
void append_cuts(const CutTree& tree, const NodeRange& range, int first, int last, wire::Json& out) {
  if (range.leaf() || range.node >= last || range.node + range.parts() - 1 <= first) return;
  if (range.node >= first) out.push_back(cut_json(tree, range));
  append_cuts(tree, range.left(), first, last, out);
  append_cuts(tree, range.right(), first, last, out);
}

wire::Json bound_json(double bound) { return std::isfinite(bound) ? wire::Json(bound) : wire::Json(nullptr); }

}  // namespace

wire::Json cuts_json(const CutTree& tree, int first, int last) {
  wire::Json cuts = wire::Json::array();
  append_cuts(tree, tree.root(), first, last, cuts);
  return cuts;
}

wire::Json regions_json(const CutTree& tree, int first, int last) {
  wire::Json regions = wire::Json::array();
  int part = first;
  for (const geometry::Box& box : tree.regions(first, last)) {
    const bool empty = box.empty(tree.dims);
    wire::Json lo = wire::Json::array();
    wire::Json hi = wire::Json::array();
    for (std::size_t a = 0; a < static_cast<std::size_t>(tree.dims); ++a) {
      lo.push_back(empty ? wire::Json(nullptr) : bound_json(box.lo[a]));
      hi.push_back(empty ? wire::Json(nullptr) : bound_json(box.hi[a]));
    }
    wire::Json region{{"part", part++}, {"lo", std::move(lo)}, {"hi", std::move(hi)}};
    if (empty) region["empty"] = true;
    regions.push_back(std::move(region));
  }
  return regions;
}

wire::Json narrowest_json(const cuts::Cuts& cuts) {
  const auto found = cuts.narrowest();
  if (!found) return nullptr;
  return {{"part", found->part}, {"axis", found->axis}, {"width", wire::number_json(found->width)}};
}

Status put_cut_arrays(const Context& context, Response& response, wire::Json& json, Scene& scene) {
  constexpr std::uint64_t kBytesOfPart = 512;
  const auto parts = static_cast<std::uint64_t>(scene.options.parts);
  if (Status room = room_for(context.comm, parts * kBytesOfPart, "the cuts"); !room.ok()) return room;
  json = {{"epoch", scene.epoch},
          {"dims", scene.tree->dims},
          {"method", cuts::method_name(scene.tree->method)},
          {"parts", scene.tree->parts},
          {"hash", wire::hex64(scene.hash)}};
  for (wire::Array& array : api::cut_arrays(*scene.tree)) response.arrays.push_back(std::move(array));
  return {};
}

void put_cuts_unless_known(const Context& context, Response& response, Scene& scene, const PushRequest& push) {
  wire::Json json;
  if (push.cuts_known && *push.cuts_known != api::CutsId{scene.epoch, scene.hash} &&
      put_cut_arrays(context, response, json, scene).ok())
    response.json["cuts"] = std::move(json);
}

}  // namespace rcb::service
