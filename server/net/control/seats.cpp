// SeatGroups, part 1: who holds which seat, and how seats are named in messages.
#include "server/net/control/seats.hpp"

#include <algorithm>
#include <utility>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <spdlog/spdlog.h>

#include "common/base/text.hpp"
#include "common/wire/field_reader.hpp"
#include "common/wire/limits.hpp"
#include "server/net/control/coordinator.hpp"

namespace rcb::net {

using wire::Json;

Json claim_json(const SeatClaim& claim) {
  return {{"seat", claim.seat}, {"seats", claim.seats}, {"generation", claim.generation}};
}

Result<std::optional<SeatClaim>> read_claim(const Json& request) {
  const auto given = [&request](const char* name) { return request.contains(name) && !request[name].is_null(); };
  if (!given("seat") && !given("seats")) return std::optional<SeatClaim>();
  wire::FieldReader fields(request);
  SeatClaim asked;
  asked.seats = static_cast<int>(fields.integer("seats", 1, wire::kSeatsMax));
  asked.seat = static_cast<int>(fields.integer("seat", 0, asked.seats - 1));
  asked.generation = static_cast<std::uint64_t>(fields.integer_or("generation", 1, wire::kIntegerMax - 1, 0));
  if (!fields.ok()) return fields.status();
  return std::optional(asked);
}

SeatGroups::SeatGroups(Coordinator& coordinator) : coordinator_(coordinator) {}

SeatGroups::Group* SeatGroups::find(const std::string& scene) {
  const auto found = groups_.find(scene);
  return found == groups_.end() ? nullptr : &found->second;
}

const SeatGroups::Group* SeatGroups::find(const std::string& scene) const {
  const auto found = groups_.find(scene);
  return found == groups_.end() ? nullptr : &found->second;
}

bool SeatGroups::knows(const std::string& scene, const Connection* connection) const {
  const Group* group = find(scene);
  return group != nullptr && group->seat_by_connection.contains(connection);
}

std::string SeatGroups::holders(const std::string& scene) const {
  const Group* group = find(scene);
  if (group == nullptr) return "";
  const bool any = std::any_of(group->seats.begin(), group->seats.end(),
                               [](const Seat& seat) { return seat.connection != nullptr; });
  return any ? fmt::format("{} seat{}", group->seats.size(), group->seats.size() == 1 ? "" : "s") : "";
}

Status SeatGroups::check_free(const std::string& scene) const {
  const std::string seats = holders(scene);
  if (seats.empty()) return {};
  return {Code::busy, fmt::format("scene '{}' is pushed by {}", scene, seats), "try again when they have closed it"};
}

Result<SeatClaim> SeatGroups::join(const std::string& scene, SeatClaim wanted, const Connection* connection,
                                   const std::string& client) {
  const auto seats = static_cast<std::size_t>(wanted.seats);
  if (knows(scene, connection))
    return Status(Code::invalid_argument, fmt::format("this connection has a seat of scene '{}' already", scene),
                  "a connection for each seat");
  Group* group = find(scene);
  if (group != nullptr && group->seats.size() != seats) {
    if (!holders(scene).empty())
      return Status(Code::invalid_argument,
                    fmt::format("seat {} of {}, but scene '{}' has {} seats", wanted.seat, wanted.seats, scene,
                                group->seats.size()),
                    "all seats say the same 'seats'");
    groups_.erase(scene);
    group = nullptr;
  }
  if (group == nullptr) {
    group = &groups_[scene];
    group->seats.resize(seats);
  }
  Seat& seat = group->seats[static_cast<std::size_t>(wanted.seat)];
  if (wanted.generation == 0 && seat.connection != nullptr)
    return Status(
        Code::busy,
        fmt::format("seat {} of scene '{}' is '{}', generation {}", wanted.seat, scene, seat.client, seat.generation),
        "another number, or the next generation if that client is known to be gone");
  if (wanted.generation == 0) wanted.generation = seat.generation + 1;
  if (wanted.generation <= seat.generation)
    return Status(Code::busy,
                  fmt::format("seat {} of scene '{}' has had generation {}; {} is not above it", wanted.seat, scene,
                              seat.generation, wanted.generation),
                  "who returns to a seat comes with a higher generation");
  const auto number = static_cast<std::size_t>(wanted.seat);
  if (seat.connection != nullptr)
    abort_step_because_of(scene, number, fmt::format("has returned with generation {}", wanted.generation));
  group->seat_by_connection[connection] = number;
  seat.connection = connection;
  seat.client = client;
  seat.generation_before = std::exchange(seat.generation, wanted.generation);
  return wanted;
}

std::optional<std::size_t> SeatGroups::seat_of(const Group& group, const Connection* connection) {
  const auto found = group.seat_by_connection.find(connection);
  if (found == group.seat_by_connection.end() || group.seats[found->second].connection != connection)
    return std::nullopt;
  return found->second;
}

void SeatGroups::leave(const std::string& scene, const Connection* connection, const std::string& why) {
  Group* group = find(scene);
  if (group == nullptr) return;
  if (const auto seat = seat_of(*group, connection)) {
    abort_step_because_of(scene, *seat, why);
    group->seats[*seat].connection = nullptr;
  }
  group->seat_by_connection.erase(connection);
  if (!coordinator_.scenes().contains(scene) && group->seat_by_connection.empty()) groups_.erase(scene);
}

void SeatGroups::give_back_seat(const std::string& scene, const Connection* connection) {
  const Group* before = find(scene);
  const auto seat = before == nullptr ? std::nullopt : seat_of(*before, connection);
  leave(scene, connection, "could not open the scene");
  if (Group* group = find(scene); group != nullptr && seat)
    group->seats[*seat].generation = group->seats[*seat].generation_before;
}

void SeatGroups::leave_all(const Connection* connection) {
  std::vector<std::string> scenes;
  for (const auto& [scene, group] : groups_)
    if (knows(scene, connection)) scenes.push_back(scene);
  for (const std::string& scene : scenes) leave(scene, connection, "has lost its connection");
}

// Aborts the open step of the seats, if there is one, and names this seat as the cause.
void SeatGroups::abort_step_because_of(const std::string& scene, std::size_t seat, const std::string& why) {
  const SceneGate& gate = coordinator_.gate(scene);
  const auto given_up = [&](std::int64_t step) {
    return Status(Code::aborted,
                  fmt::format("step {} of scene '{}' was given up: {} {}", step, scene, name(scene, seat), why),
                  "the previous step stands; bring it again");
  };
  if (gate.step && gate.step->by_seats()) abort(*gate.step, given_up(gate.step->number));
  if (const auto counting = coordinator_.gate(scene).counting) end_count(scene, given_up(counting->number));
  coordinator_.erase_gate_if_unused(scene);
}

std::string SeatGroups::name(const std::string& scene, std::size_t seat) const {
  const Group* group = find(scene);
  if (group == nullptr) return fmt::format("seat {}", seat);
  const Seat& one = group->seats[seat];
  if (one.generation == 0) return fmt::format("seat {} (has not opened the scene)", seat);
  if (one.connection == nullptr) return fmt::format("seat {} ('{}', gone)", seat, one.client);
  return fmt::format("seat {} ('{}')", seat, one.client);
}

std::string SeatGroups::missing(const OpenStep& step) const {
  if (!step.by_seats()) return fmt::format("{} ({})", step.who(), step.progress());
  std::vector<std::size_t> missing;
  for (std::size_t k = 0; k < step.shares.size(); ++k)
    if (!step.shares[k] || !step.shares[k]->ready()) missing.push_back(k);
  return names_of(step.scene, missing);
}

std::string SeatGroups::names_of(const std::string& scene, std::span<const std::size_t> seats) const {
  constexpr std::size_t kNamedMax = 8;
  std::vector<std::string> names;
  for (const std::size_t seat : seats.first(std::min(seats.size(), kNamedMax))) names.push_back(name(scene, seat));
  return fmt::format("{}{}", fmt::join(names, ", "), and_more(seats.size() - names.size()));
}

void SeatGroups::scene_changed(const std::string& scene) {
  if (!coordinator_.scenes().contains(scene) && holders(scene).empty()) groups_.erase(scene);
}

}  // namespace rcb::net
