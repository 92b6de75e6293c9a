#include "tests/bench/rows.hpp"

#include <algorithm>
#include <map>

#include <fmt/format.h>

#include "tests/bench/json.hpp"

namespace rcb::bench {
namespace {

// Each peer at its fastest setting, by its name in `ratio`.
std::map<std::string, const Measurement*> fastest_peers(const std::vector<Measurement>& measured) {
  std::map<std::string, const Measurement*> peers;
  for (const Measurement& m : measured) {
    if (m.setting.tool == "rcbd" || m.setting.work != kPartition || !m.failure.empty()) continue;
    const Measurement*& best = peers[m.setting.tool == kFloor ? kRead : m.setting.tool + " " + m.setting.method];
    if (best == nullptr || median(m.seconds) < median(best->seconds)) best = &m;
  }
  return peers;
}

// The median over the repeats of our seconds over the peer's in the same repeat.
double ratio(const Measurement& ours, const Measurement& peer) {
  std::vector<double> ratios;
  for (std::size_t r = 0; r < ours.seconds.size(); ++r) ratios.push_back(ours.seconds[r] / peer.seconds[r]);
  return median(std::move(ratios));
}

}  // namespace

Json make_rows_json(const Cell& cell, int dims, int ranks, const std::vector<Measurement>& measured) {
  const auto peers = fastest_peers(measured);
  Json rows = Json::array();
  for (const Measurement& m : measured) {
    const Setting& s = m.setting;
    Json row{{"scene", cell.scene}, {"n", cell.n},    {"dims", dims},
             {"parts", cell.parts}, {"ranks", ranks}, {"tool", s.tool},
             {"method", s.method},  {"work", s.work}, {"cut_tolerance", s.cut_tolerance}};
    Json ratio_of = Json::object();
    if (m.failure.empty()) {
      const auto [least, most] = std::minmax_element(m.seconds.begin(), m.seconds.end());
      row.update({{"seconds", median(m.seconds)}, {"seconds_min", *least}, {"seconds_max", *most}});
      row.update({{"error", m.error}, {"empty_parts", m.empty_parts}, {"imbalance", m.imbalance}});
      if (s.tool == "rcbd" && s.work == kPartition && s.cut_tolerance == 0)
        for (const auto& [name, peer] : peers) ratio_of[name] = ratio(m, *peer);
    } else {
      for (const char* field : {"seconds", "seconds_min", "seconds_max", "error", "empty_parts", "imbalance"})
        row[field] = nullptr;
      row["failure"] = m.failure;
    }
    row["ratio"] = ratio_of;
    if (m.hash) row["hash"] = fmt::format("{:016x}", *m.hash);
    if (m.cost) {
      row["rounds"] = m.cost->rounds;
      row["reductions"] = m.cost->reductions;
    }
    if (m.cost && cell.n > 0) {
      row["reads"] = static_cast<double>(m.cost->reads) / static_cast<double>(cell.n);
      row["bytes_moved"] = static_cast<double>(m.cost->bytes) / static_cast<double>(cell.n);
    }
    if (m.bytes_per_particle) row["bytes_per_particle"] = *m.bytes_per_particle;
    rows.push_back(std::move(row));
  }
  return rows;
}

}  // namespace rcb::bench
