#include "tests/bench/step/step_seats.hpp"

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

struct SeatTeam::Seat {
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

SeatTeam::SeatTeam(const std::array<std::vector<double>, 3> (&axes)[2], int dims, int seats)
    : axes_(axes), dims_(dims) {
  for (int k = 0; k < seats; ++k) seats_.push_back(std::make_unique<Seat>());
}
SeatTeam::~SeatTeam() = default;
SeatTeam::SeatTeam(SeatTeam&&) noexcept = default;

Status SeatTeam::open(const std::string& endpoint, const std::string& scene, client::Path path) {
  const int seats = static_cast<int>(seats_.size());
  for (int k = 0; k < seats; ++k) {
    Seat& mine = *seats_[static_cast<std::size_t>(k)];
    auto client = client::Client::connect({.endpoint = endpoint, .name = fmt::format("seat {}", k), .path = path});
    if (!client.ok()) return client.status();
    mine.client.emplace(std::move(*client));
    auto opened = mine.client->open_scene(scene, {.seat = k, .seats = seats});
    if (!opened.ok()) return opened.status();
    mine.scene.emplace(std::move(*opened));
    const std::uint64_t n = axes_[0][0].size();
    for (std::uint64_t row = layout::row_begin(k, n, seats); row < layout::row_begin(k + 1, n, seats); ++row)
      mine.ids.push_back(static_cast<std::int64_t>(row));
  }
  return {};
}

Result<double> SeatTeam::step(int phase, client::StepReport& report) {
  const SteadyClock clock;
  double start = 0;
  std::barrier ready(static_cast<std::ptrdiff_t>(seats_.size()), [&]() noexcept { start = clock.seconds(); });
  std::vector<double> ended(seats_.size());
  {
    std::vector<std::jthread> threads;
    for (std::size_t k = 0; k < seats_.size(); ++k)
      threads.emplace_back([&, k] {
        Seat& mine = *seats_[k];
        mine.take_positions(axes_[phase], dims_);
        ready.arrive_and_wait();
        mine.push(dims_);
        ended[k] = clock.seconds();
      });
  }
  for (const auto& mine : seats_)
    if (!mine->status.ok()) return mine->status;
  std::vector<std::vector<std::int64_t>> arriving(seats_.size());
  for (const auto& mine : seats_)
    for (const client::LeavingRow& one : mine->leaving)
      arriving[static_cast<std::size_t>(one.to)].push_back(std::exchange(mine->ids[one.row], -1));
  for (std::size_t k = 0; k < seats_.size(); ++k) {
    std::erase(seats_[k]->ids, -1);
    std::ranges::copy(arriving[k], std::back_inserter(seats_[k]->ids));
  }
  report = seats_.front()->report;
  return *std::max_element(ended.begin(), ended.end()) - start;
}

}  // namespace rcb::bench
