#include "tests/bench/step/step_members.hpp"

#include <algorithm>
#include <barrier>
#include <iterator>
#include <optional>
#include <thread>
#include <utility>

#include <fmt/format.h>

#include "common/base/clock.hpp"
#include "common/layout/layout.hpp"

namespace rcb::bench {

struct MemberTeam::Member {
  std::optional<client::Client> client;
  std::optional<client::Scene> scene;
  std::vector<std::int64_t> ids;  // of the particles it has: their rows
  std::array<std::vector<double>, 3> position;
  Status status;
  client::StepReport report;
  std::vector<client::LeavingRow> leaving;  // as the last answer said

  void take_positions(const std::array<std::vector<double>, 3>& axes, int dims) {
    for (std::size_t a = 0; a < static_cast<std::size_t>(dims); ++a) {
      position[a].resize(ids.size());
      for (std::size_t i = 0; i < ids.size(); ++i) position[a][i] = axes[a][static_cast<std::size_t>(ids[i])];
    }
  }
  void push(int dims) {
    std::array<const double*, 3> pointers{};
    for (std::size_t a = 0; a < static_cast<std::size_t>(dims); ++a) pointers[a] = position[a].data();
    auto answer = scene->step(
        client::Positions::axes(std::span(pointers).first(static_cast<std::size_t>(dims)), ids.size()), {.ids = ids});
    status = answer.status();
    if (!status.ok()) return;
    report = std::move(answer->report);
    leaving = std::move(answer->leaving);
  }
};

MemberTeam::MemberTeam(const std::array<std::vector<double>, 3> (&axes)[2], int dims, int members)
    : axes_(axes), dims_(dims) {
  for (int k = 0; k < members; ++k) members_.push_back(std::make_unique<Member>());
}
MemberTeam::~MemberTeam() = default;
MemberTeam::MemberTeam(MemberTeam&&) noexcept = default;

Status MemberTeam::open(const std::string& endpoint, const std::string& scene, client::Path path) {
  const int members = static_cast<int>(members_.size());
  for (int k = 0; k < members; ++k) {
    Member& mine = *members_[static_cast<std::size_t>(k)];
    auto client = client::Client::connect({.endpoint = endpoint, .name = fmt::format("member {}", k), .path = path});
    if (!client.ok()) return client.status();
    mine.client.emplace(std::move(*client));
    auto opened = mine.client->open_scene(scene, {.seat = k, .seats = members});
    if (!opened.ok()) return opened.status();
    mine.scene.emplace(std::move(*opened));
    const std::uint64_t n = axes_[0][0].size();
    for (std::uint64_t row = layout::row_begin(k, n, members); row < layout::row_begin(k + 1, n, members); ++row)
      mine.ids.push_back(static_cast<std::int64_t>(row));
  }
  return {};
}

Result<double> MemberTeam::step(int phase, client::StepReport& report) {
  const SteadyClock clock;
  double start = 0;
  std::barrier ready(static_cast<std::ptrdiff_t>(members_.size()), [&]() noexcept { start = clock.seconds(); });
  std::vector<double> ended(members_.size());
  {
    std::vector<std::jthread> threads;
    for (std::size_t k = 0; k < members_.size(); ++k)
      threads.emplace_back([&, k] {
        Member& mine = *members_[k];
        mine.take_positions(axes_[phase], dims_);
        ready.arrive_and_wait();
        mine.push(dims_);
        ended[k] = clock.seconds();
      });
  }
  for (const auto& mine : members_)
    if (!mine->status.ok()) return mine->status;
  std::vector<std::vector<std::int64_t>> arriving(members_.size());
  for (const auto& mine : members_)
    for (const client::LeavingRow& one : mine->leaving)
      arriving[static_cast<std::size_t>(one.to)].push_back(std::exchange(mine->ids[one.row], -1));
  for (std::size_t k = 0; k < members_.size(); ++k) {
    std::erase(members_[k]->ids, -1);
    std::ranges::copy(arriving[k], std::back_inserter(members_[k]->ids));
  }
  report = members_.front()->report;
  return *std::max_element(ended.begin(), ended.end()) - start;
}

}  // namespace rcb::bench
