// cuts: the current cut tree and the region of each part.
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include <fmt/format.h>

#include "client/cli/commands/near.hpp"
#include "client/cli/print/output.hpp"
#include "client/cli/print/parts_table.hpp"

namespace rcb::cli {
namespace {

constexpr std::size_t kCutsShownMax = 31;  // five levels of the tree

struct CutsOptions {
  std::string name;
  bool all = false;
};

// Prints coordinates with enough digits to tell the cuts of an axis apart, however far from the origin they lie.
class Coordinates {
 public:
  explicit Coordinates(const Json& cuts) {
    for (const Json& cut : cuts)
      if (cut.at("at").is_number()) extend_range(cut.at("axis").get<std::size_t>(), cut["at"].get<double>());
  }

  std::string text(std::size_t axis, double value) const {
    constexpr int kDigits = 4;
    constexpr double kPlainMax = 1e7;
    const Range range = axis < ranges_.size() ? ranges_[axis] : Range{};
    const double far = std::max(std::fabs(range.lo), std::fabs(range.hi));
    const double spread = range.hi / 2 - range.lo / 2;
    int digits = kDigits;
    if (spread > 0 && std::isfinite(far)) digits += static_cast<int>(std::log10(far / 2) - std::log10(spread));
    if (far >= 1 && far < kPlainMax) digits = std::max(digits, 1 + static_cast<int>(std::log10(far)));
    return fmt::format("{:.{}g}", value + 0.0, std::clamp(digits, kDigits, std::numeric_limits<double>::max_digits10));
  }

 private:
  struct Range {
    double lo = std::numeric_limits<double>::infinity();
    double hi = -std::numeric_limits<double>::infinity();
  };

  void extend_range(std::size_t axis, double value) {
    if (axis >= ranges_.size()) return;
    ranges_[axis].lo = std::min(ranges_[axis].lo, value);
    ranges_[axis].hi = std::max(ranges_[axis].hi, value);
  }

  std::array<Range, 3> ranges_;
};

// "y 5, z 0, id 505": the tie-break for a particle whose coordinate equals the cut's.
std::string ties_text(const Json& cut, const Coordinates& coordinates) {
  const Json ties = cut.value("ties", Json());
  if (!ties.is_object()) return "";
  std::string text;
  const Json& axes = ties.at("axes");
  for (std::size_t k = 0; k < axes.size(); ++k)
    text += fmt::format("{} {}, ", axis_name(axes[k]),
                        coordinates.text(axes[k].get<std::size_t>(), ties.at("at").at(k).get<double>()));
  return text + "id " + text_of(ties, "id");
}

std::string child_text(const Json& child) {
  return child.contains("part") ? "part " + text_of(child, "part") : "cut " + text_of(child, "node");
}

std::string region_text(const Json& region, const Coordinates& coordinates) {
  if (region.value("empty", false)) return "empty";
  const Json& lo = region.at("lo");
  const Json& hi = region.at("hi");
  std::string text;
  for (std::size_t a = 0; a < lo.size(); ++a)
    text += fmt::format("{}[{}, {})", a == 0 ? "" : " x ",
                        lo[a].is_null() ? "-inf" : coordinates.text(a, lo[a].get<double>()),
                        hi.at(a).is_null() ? "inf" : coordinates.text(a, hi[a].get<double>()));
  return text;
}

void print_cut_table(const Json& cuts, const std::vector<std::size_t>& shown, const Coordinates& coordinates) {
  Table table({{"cut"},
               {"axis"},
               {"at"},
               {"where equal", Table::Align::left},
               {"below", Table::Align::left},
               {"from there", Table::Align::left}});
  for (const std::size_t k : shown) {
    const Json& cut = cuts.at(k);
    const Json& at = cut.at("at");
    table.row({text_of(cut, "node"), axis_name(cut.at("axis")),
               at.is_null() ? "all below" : coordinates.text(cut["axis"].get<std::size_t>(), at.get<double>()),
               ties_text(cut, coordinates), child_text(cut.at("left")), child_text(cut.at("right"))});
  }
  table.print();
}

// The cuts to be shown: all, or those of the tree's upper levels, level by level.
std::vector<std::size_t> cuts_shown(const Json& cuts, bool all) {
  std::vector<std::size_t> order;
  if (all || cuts.size() <= kCutsShownMax) {
    for (std::size_t k = 0; k < cuts.size(); ++k) order.push_back(k);
    return order;
  }
  std::vector<std::size_t> place(cuts.size());  // index of each node's cut
  for (std::size_t k = 0; k < cuts.size(); ++k) place.at(cuts[k].at("node").get<std::size_t>()) = k;
  order.push_back(place.at(0));
  for (std::size_t k = 0; k < order.size() && order.size() < kCutsShownMax; ++k)
    for (const char* side : {"left", "right"})
      if (const Json& child = cuts[order[k]].at(side); child.contains("node") && order.size() < kCutsShownMax)
        order.push_back(place.at(child["node"].get<std::size_t>()));
  return order;
}

void print_cuts(const Json& reply, bool all) {
  const Json& cuts = reply.at("cuts");
  const Json& regions = reply.at("regions");
  const Coordinates coordinates(cuts);
  print_line(fmt::format("{}, {} parts, epoch {}, hash {}", text_of(reply, "method"), text_of(reply, "parts"),
                         text_of(reply, "epoch"), text_of(reply, "hash")));
  print_line(narrowest_text(reply));
  print_line("");
  const auto shown = cuts_shown(cuts, all);
  if (!shown.empty()) {
    print_cut_table(cuts, shown, coordinates);
    print_line("A particle whose coordinate equals the cut's is judged by the next ones in turn, at last by its id.");
    print_line("");
  }
  if (summarised(regions.size(), all)) {
    print_line(fmt::format("the upper {} of {} cuts; --all shows every one, and the region of each part", shown.size(),
                           cuts.size()));
    return;
  }
  Table table({{"part"}, {"region", Table::Align::left}});
  for (const Json& region : regions) table.row({text_of(region, "part"), region_text(region, coordinates)});
  table.print();
}

Status cuts(const CutsOptions& options, const Context& context) {
  auto client = connect(context);
  if (!client) return client.status();
  auto reply = ask_cuts(*client, options.name);
  if (!reply) return reply.status();
  return show(context, *reply, [&] { print_cuts(*reply, options.all); });
}

// Fetches all pages of one list into `known`. False: the cuts have changed since its first page.
Result<bool> add_pages(client::Client& client, const std::string& scene, const char* list, Json& known) {
  Json items = Json::array();
  for (Json from = 0; !from.is_null();) {
    auto page = ask(client, "cuts", {{"scene", scene}, {"list", list}, {"from", from}});
    if (!page) return page.status();
    for (const char* field : {"epoch", "method", "parts", "hash"}) {
      if (!known.contains(field)) known[field] = page->at(field);
      if (known[field] != page->at(field)) return false;
    }
    if (page->contains("narrowest_region")) known["narrowest_region"] = page->at("narrowest_region");
    for (Json& item : page->at(list)) items.push_back(std::move(item));
    if (page->at("next") == from) return Status(Code::protocol_error, "the answer to cuts: its pages have no end");
    from = page->at("next");
  }
  known[list] = std::move(items);
  return true;
}

}  // namespace

Result<Json> ask_cuts(client::Client& client, const std::string& scene) {
  constexpr int kTries = 10;
  for (int k = 0; k < kTries; ++k) {
    Json all = Json::object();
    auto whole = add_pages(client, scene, "cuts", all);
    if (whole && *whole) whole = add_pages(client, scene, "regions", all);
    if (!whole) return whole.status();
    if (*whole) return all;
  }
  return Status(Code::aborted, fmt::format("the cuts of scene '{}' changed while they were read", scene), "ask again");
}

void add_cuts_command(CLI::App& app, Context& context) {
  auto [command, options] =
      add_command(app, context,
                  {"cuts", "The cuts in force, each with its whole key, and the region of each part",
                   "  rcbctl cuts jet\n  rcbctl cuts jet --json", kAskGroup},
                  cuts);
  add_scene_name(command, options.name);
  command.add_flag("--all", options.all, kAllHelp);
}

}  // namespace rcb::cli
