// What the coordinator tells about the service: the answer to `status`, and whom or what a client waits for.
#include <algorithm>
#include <chrono>
#include <filesystem>
#include <string_view>
#include <unordered_map>
#include <utility>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <unistd.h>

#include "common/base/nearest.hpp"
#include "common/base/text.hpp"
#include "common/files/paths.hpp"
#include "common/files/process_id.hpp"
#include "server/net/control/coordinator.hpp"
#include "server/net/control/session.hpp"
#include "server/net/files/process_memory.hpp"
#include "server/net/sockets/file_thread.hpp"

namespace rcb::net {

using wire::Json;

namespace {

constexpr double kLookSeconds = 0.5;  // that `status` waits for the disk

}  // namespace

void Holders::add(std::string_view name) {
  ++count;
  if (first.size() == kNamed && name >= first.back()) return;
  first.insert(std::upper_bound(first.begin(), first.end(), name), name);
  if (first.size() > kNamed) first.pop_back();
}

std::string Holders::in_words() const {
  return fmt::format("{}{}", fmt::join(first, ", "), and_more(count - first.size()));
}

Holders Coordinator::holders(const std::string& scene, const std::string& except) const {
  Holders holders;
  for (const Session* session : sessions_)
    if (session->has_open(scene) && (except.empty() || session->number() != except)) holders.add(session->client());
  return holders;
}

Status Coordinator::unknown_scene(const std::string& scene) const {
  constexpr std::size_t kNamesMax = 8;
  constexpr std::size_t kComparedMax = 100;  // comparing more names takes too long on the I/O thread
  std::vector<std::string> names;
  for (const auto& [name, ledger] : scenes_) names.push_back(name);
  std::string hint;
  if (!names.empty()) {
    if (names.size() <= kComparedMax)
      if (const auto near = names_like(scene, names); !near.empty())
        hint = fmt::format("did you mean {}? ", near.front());
    const std::size_t shown = std::min(names.size(), kNamesMax);
    hint += fmt::format("there {} {}{}", names.size() == 1 ? "is" : "are:",
                        fmt::join(names.begin(), names.begin() + static_cast<std::ptrdiff_t>(shown), ", "),
                        and_more(names.size() - shown));
  } else {
    hint = "there is none yet: create it first";
  }
  return {Code::not_found, fmt::format("no scene '{}'", scene), hint};
}

Json Coordinator::scenes_json() const {
  // Sessions may hold a million scenes together: nothing is copied.
  std::unordered_map<std::string_view, Holders> holders;
  for (const Session* session : sessions_)
    for (const std::string& scene : session->open()) holders[scene].add(session->client());
  Json scenes = Json::array();
  for (const auto& [name, ledger] : scenes_) {
    const Holders& of_scene = holders[name];
    const scene::SceneState& scene = ledger.now();
    const double steps = static_cast<double>(std::max<std::uint64_t>(1, ledger.totals().steps));
    scenes.push_back({{"scene", name},
                      {"n", scene.n},
                      {"dims", scene.options.dims},
                      {"parts", scene.options.parts},
                      {"step", scene.step ? Json(*scene.step) : Json()},
                      {"epoch", scene.epoch},
                      {"error", scene.loads ? Json(scene.loads->error) : Json()},
                      {"imbalance", scene.loads ? Json(scene.loads->imbalance) : Json()},
                      {"mean_step_seconds", scene.loads ? Json(ledger.totals().seconds.total / steps) : Json()},
                      {"holders", of_scene.first},
                      {"holders_count", of_scene.count}});
  }
  return scenes;
}

awaitable<void> Coordinator::look_at_log() {
  // The launcher redirects standard error to this file. A file last written before this service started is an earlier
  // service's. The file system's clock may lag a little.
  constexpr std::chrono::seconds kLag(2);
  if (!log_look_ && !options_.data_dir.empty()) {
    const auto path = std::make_shared<std::string>(join_path(options_.data_dir, kLogFile));
    const Status begun = FileThread::of(context_).run(
        [path, since = started_on_disk_ - kLag] {
          std::error_code fault;
          const auto written = std::filesystem::last_write_time(*path, fault);
          if (fault || written < since) path->clear();
        },
        [self = shared_from_this(), path] {
          self->log_path_ = *path;
          std::exchange(self->log_look_, nullptr)->cancel();
        });
    if (begun.ok()) log_look_ = std::make_shared<Timer>(context_, now() + duration_of(kLookSeconds));
  }
  if (const auto look = log_look_) co_await look->async_wait(kAwait);
}

Json Coordinator::status_json() const {
  static const Json own_process{{"id", ProcessId::self().text()}, {"space", process_space()}};
  Json memory = Json::array({resident_bytes()});
  for (std::size_t rank = 1; rank < memory_bytes_.size(); ++rank)
    memory.push_back(memory_bytes_[rank] == 0 ? Json() : Json(memory_bytes_[rank]));
  std::uint64_t steps = 0;
  for (const auto& [name, ledger] : scenes_) steps += ledger.totals().steps;
  return {{"version", options_.version},
          {"ranks", options_.ranks},
          {"pid", ::getpid()},
          {"process", own_process},
          {"uptime_seconds", seconds_since(started_)},
          {"endpoints", endpoints_},
          {"encryption", encryption_},
          {"data_dir", options_.data_dir},
          {"log", log_path_.empty() ? Json() : Json(log_path_)},
          {"memory_bytes", memory},
          {"hosts", hosts_json()},
          {"empty", scenes_.empty()},
          {"restarted", options_.restarted},
          {"restored",
           {{"scenes", restored_.scenes}, {"steps", restored_.steps}, {"lost_records", restored_.lost_records}}},
          {"sessions", sessions_.size()},
          {"silent", silent_json()},
          {"unfinished", unfinished_json()},
          {"scenes", scenes_json()},
          {"steps", steps}};
}

Json Coordinator::hosts_json() const {
  Json hosts = Json::array();
  for (std::size_t rank = 0; rank < options_.hosts.size(); ++rank) {
    Json addresses = Json::array();
    for (const auto& [endpoint, of_ranks] : data_addresses_)
      if (rank < of_ranks.size()) addresses.push_back(of_ranks[rank]);
    const RankHost& one = options_.hosts[rank];
    hosts.push_back({{"rank", rank}, {"host", one.host}, {"pid", one.pid}, {"addresses", std::move(addresses)}});
  }
  return hosts;
}

Json Coordinator::silent_json() const {
  Json silent = Json::array();
  if (!silent_ranks_) return silent;
  for (const SilentRank& one : silent_ranks_()) silent.push_back({{"rank", one.rank}, {"seconds", one.seconds}});
  return silent;
}

std::string Coordinator::engine_in_words() const {
  std::string words;
  if (silent_ranks_)
    for (const SilentRank& one : silent_ranks_()) {
      const auto rank = static_cast<std::size_t>(one.rank);
      const bool elsewhere = rank < options_.hosts.size() && options_.hosts[rank].host != options_.hosts[0].host;
      words += fmt::format("{}rank {}{}, silent for {:.0f} s", words.empty() ? "" : ", ", one.rank,
                           elsewhere ? " on " + options_.hosts[rank].host : "", one.seconds);
    }
  return words.empty() ? "the engine" : words;
}

}  // namespace rcb::net
