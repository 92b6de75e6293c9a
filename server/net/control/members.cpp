// MemberGroups, part 1: who holds which seat, and how members are named in messages.
#include "server/net/control/members.hpp"

#include <algorithm>
#include <utility>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <spdlog/spdlog.h>

#include "common/wire/field_reader.hpp"
#include "common/wire/limits.hpp"
#include "server/net/control/coordinator.hpp"

namespace rcb::net {

using wire::Json;

Json membership_json(const Membership& membership) {
  return {{"member", membership.member}, {"members", membership.members}, {"generation", membership.generation}};
}

Result<std::optional<Membership>> read_membership(const Json& request) {
  const auto given = [&request](const char* name) { return request.contains(name) && !request[name].is_null(); };
  if (!given("member") && !given("members")) return std::optional<Membership>();
  wire::FieldReader fields(request);
  Membership asked;
  asked.members = static_cast<int>(fields.integer("members", 1, wire::kSeatsMax));
  asked.member = static_cast<int>(fields.integer("member", 0, asked.members - 1));
  asked.generation = static_cast<std::uint64_t>(fields.integer_or("generation", 1, wire::kIntegerMax - 1, 0));
  if (!fields.ok()) return fields.status();
  return std::optional(asked);
}

std::string MemberPush::progress() const {
  const auto whole = std::count_if(contributions.begin(), contributions.end(),
                                   [](const auto& contribution) { return contribution && contribution->ready(); });
  return fmt::format("{} of {} members", whole, contributions.size());
}

bool MemberPush::all_ready() {
  while (ready < contributions.size() && contributions[ready] && contributions[ready]->ready()) ++ready;
  return ready == contributions.size();
}

bool MemberPush::awaits(const Connection* connection) const {
  return std::any_of(contributions.begin(), contributions.end(), [connection](const auto& contribution) {
    return contribution && contribution->connection.get() == connection && !contribution->ready();
  });
}

MemberGroups::MemberGroups(Coordinator& coordinator) : coordinator_(coordinator) {}

MemberGroups::Group* MemberGroups::find(const std::string& scene) {
  const auto found = groups_.find(scene);
  return found == groups_.end() ? nullptr : &found->second;
}

const MemberGroups::Group* MemberGroups::find(const std::string& scene) const {
  const auto found = groups_.find(scene);
  return found == groups_.end() ? nullptr : &found->second;
}

bool MemberGroups::knows(const std::string& scene, const Connection* connection) const {
  const Group* group = find(scene);
  return group != nullptr && group->seat_by_connection.contains(connection);
}

std::shared_ptr<OpenPush> MemberGroups::contribution_of(const MemberPush& step, const Connection* connection) const {
  const Group* group = find(step.scene);
  const auto member = group == nullptr || step.over ? std::nullopt : seat_of(*group, connection);
  return member ? step.contributions[*member] : nullptr;
}

std::string MemberGroups::holders(const std::string& scene) const {
  const Group* group = find(scene);
  if (group == nullptr) return "";
  const bool any = std::any_of(group->seats.begin(), group->seats.end(),
                               [](const Seat& seat) { return seat.connection != nullptr; });
  return any ? fmt::format("{} member{}", group->seats.size(), group->seats.size() == 1 ? "" : "s") : "";
}

Status MemberGroups::check_free(const std::string& scene) const {
  const std::string members = holders(scene);
  if (members.empty()) return {};
  return {Code::busy, fmt::format("scene '{}' is pushed by {}", scene, members), "try again when they have closed it"};
}

Result<Membership> MemberGroups::join(const std::string& scene, Membership wanted, const Connection* connection,
                                      const std::string& client) {
  const auto members = static_cast<std::size_t>(wanted.members);
  if (knows(scene, connection))
    return Status(Code::invalid_argument, fmt::format("this connection is a member of scene '{}' already", scene),
                  "a connection for each member");
  Group* group = find(scene);
  if (group != nullptr && group->seats.size() != members) {
    if (!holders(scene).empty())
      return Status(Code::invalid_argument,
                    fmt::format("member {} of {}, but scene '{}' is open by members of {}", wanted.member,
                                wanted.members, scene, group->seats.size()),
                    "all members say the same 'members'");
    groups_.erase(scene);
    group = nullptr;
  }
  if (group == nullptr) {
    group = &groups_[scene];
    group->seats.resize(members);
  }
  Seat& seat = group->seats[static_cast<std::size_t>(wanted.member)];
  if (wanted.generation == 0 && seat.connection != nullptr)
    return Status(Code::busy,
                  fmt::format("member {} of scene '{}' is '{}', generation {}", wanted.member, scene, seat.client,
                              seat.generation),
                  "another number, or the next generation if that client is known to be gone");
  if (wanted.generation == 0) wanted.generation = seat.generation + 1;
  if (wanted.generation <= seat.generation)
    return Status(Code::busy,
                  fmt::format("member {} of scene '{}' has had generation {}; {} is not above it", wanted.member, scene,
                              seat.generation, wanted.generation),
                  "a member that returns comes with a higher generation");
  const auto member = static_cast<std::size_t>(wanted.member);
  if (seat.connection != nullptr)
    abort_step_because_of(scene, member, fmt::format("has returned with generation {}", wanted.generation));
  group->seat_by_connection[connection] = member;
  seat.connection = connection;
  seat.client = client;
  seat.generation_before = std::exchange(seat.generation, wanted.generation);
  return wanted;
}

std::optional<std::size_t> MemberGroups::seat_of(const Group& group, const Connection* connection) {
  const auto found = group.seat_by_connection.find(connection);
  if (found == group.seat_by_connection.end() || group.seats[found->second].connection != connection)
    return std::nullopt;
  return found->second;
}

void MemberGroups::leave(const std::string& scene, const Connection* connection, const std::string& why) {
  Group* group = find(scene);
  if (group == nullptr) return;
  if (const auto member = seat_of(*group, connection)) {
    abort_step_because_of(scene, *member, why);
    group->seats[*member].connection = nullptr;
  }
  group->seat_by_connection.erase(connection);
  if (!coordinator_.scenes().contains(scene) && group->seat_by_connection.empty()) groups_.erase(scene);
}

void MemberGroups::give_back_seat(const std::string& scene, const Connection* connection) {
  const Group* before = find(scene);
  const auto member = before == nullptr ? std::nullopt : seat_of(*before, connection);
  leave(scene, connection, "could not open the scene");
  if (Group* group = find(scene); group != nullptr && member)
    group->seats[*member].generation = group->seats[*member].generation_before;
}

void MemberGroups::leave_all(const Connection* connection) {
  std::vector<std::string> scenes;
  for (const auto& [scene, group] : groups_)
    if (knows(scene, connection)) scenes.push_back(scene);
  for (const std::string& scene : scenes) leave(scene, connection, "has lost its connection");
}

// Aborts the open step of the members, if there is one, and names this member as the cause.
void MemberGroups::abort_step_because_of(const std::string& scene, std::size_t member, const std::string& why) {
  const auto push = coordinator_.gate(scene).push;
  if (push && push->round)
    abort(push->round, nullptr,
          {Code::aborted,
           fmt::format("step {} of scene '{}' was given up: {} {}", push->round->step, scene, name(scene, member), why),
           "the previous step stands; push again"});
  if (Group* group = find(scene); group != nullptr && group->counting)
    end_count(*group, {Code::aborted,
                       fmt::format("step {} of scene '{}' was given up: {} {}", group->counting->tally.step(), scene,
                                   name(scene, member), why),
                       "the previous step stands; count or push again"});
  coordinator_.erase_gate_if_unused(scene);
}

std::string MemberGroups::name(const std::string& scene, std::size_t member) const {
  const Group* group = find(scene);
  if (group == nullptr) return fmt::format("member {}", member);
  const Seat& seat = group->seats[member];
  if (seat.generation == 0) return fmt::format("member {} (has not opened the scene)", member);
  if (seat.connection == nullptr) return fmt::format("member {} ('{}', gone)", member, seat.client);
  return fmt::format("member {} ('{}')", member, seat.client);
}

std::string MemberGroups::missing(const MemberPush& step) const {
  std::vector<std::size_t> missing;
  for (std::size_t k = 0; k < step.contributions.size(); ++k)
    if (!step.contributions[k] || !step.contributions[k]->ready()) missing.push_back(k);
  return names_of(step.scene, missing);
}

std::string MemberGroups::names_of(const std::string& scene, std::span<const std::size_t> members) const {
  constexpr std::size_t kNamedMax = 8;
  std::vector<std::string> names;
  for (const std::size_t member : members.first(std::min(members.size(), kNamedMax)))
    names.push_back(name(scene, member));
  const std::size_t more = members.size() - names.size();
  return fmt::format("{}{}", fmt::join(names, ", "), more > 0 ? fmt::format(" and {} more", more) : "");
}

Status MemberGroups::late(const MemberPush& step) const {
  return {Code::deadline_exceeded,
          fmt::format("step {} of scene '{}' was given up at its deadline: {} had not pushed it", step.step, step.scene,
                      missing(step)),
          "the previous step stands; push again"};
}

void MemberGroups::scene_changed(const std::string& scene) {
  if (!coordinator_.scenes().contains(scene) && holders(scene).empty()) groups_.erase(scene);
}

}  // namespace rcb::net
