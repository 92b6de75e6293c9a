#include "server/net/control/kept_answers.hpp"

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <ctime>
#include <filesystem>
#include <string_view>
#include <utility>

#include <fcntl.h>
#include <fmt/format.h>
#include <spdlog/spdlog.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/files/own_files.hpp"
#include "common/files/paths.hpp"
#include "common/wire/frame.hpp"
#include "common/wire/limits.hpp"

namespace rcb::net {
namespace {

constexpr std::string_view kPrefix = "answers.";
constexpr std::size_t kHeadBytes = 16;  // byte count and XXH3-64 of what follows

std::span<const std::byte> bytes_of(std::string_view text) { return std::as_bytes(std::span(text)); }

std::string number_bytes(std::uint64_t value) {
  const auto bytes = wire::BulkChecksum::encode(value);
  return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
}

std::uint64_t number_at(std::string_view bytes) {
  std::array<std::byte, 8> raw{};
  std::memcpy(raw.data(), bytes.data(), raw.size());
  return wire::BulkChecksum::decode(raw);
}

std::uint64_t checksum(std::string_view bytes) {
  wire::BulkChecksum sum;
  sum.add(bytes_of(bytes));
  return sum.value();
}

// One frame a member, as it would be sent.
std::string encode(const std::string& scene, const MemberAnswers& answers) {
  std::string frames;
  for (std::size_t member = 0; member < answers.sessions.size(); ++member) {
    std::vector<wire::Array> arrays;
    std::string bulk;
    for (const wire::Array& array : answers.arrays[member]) {
      if (array.name.starts_with("place_")) continue;
      arrays.push_back({array.name, array.dtype, array.shape, {}});
      bulk.append(reinterpret_cast<const char*>(array.bytes.data()), array.bytes.size());
    }
    wire::FrameHeader header;
    header.type = wire::FrameType::reply;
    header.request = member;
    header.bulk_bytes = bulk.size();
    const wire::Json json{{"scene", scene},
                          {"step", answers.step},
                          {"session", answers.sessions[member]},
                          {"answer", answers.json},
                          {"arrays", wire::describe(arrays)}};
    frames += wire::encode_frame(header, wire::dump_json(json)) + bulk;
  }
  return number_bytes(frames.size()) + number_bytes(checksum(frames)) + frames;
}

// Removes the first frame from `frames` and adds it to `answers` as the next member's answer.
Status decode_member(std::string_view& frames, std::string& scene, MemberAnswers& answers) {
  const Status cut(Code::io_error, "it ends too early");
  if (frames.size() < wire::kHeaderBytes) return cut;
  wire::HeaderBytes head{};
  std::memcpy(head.data(), frames.data(), head.size());
  frames.remove_prefix(head.size());
  const auto header = wire::decode_header(head);
  if (!header.ok()) return header.status();
  if (frames.size() < header->json_bytes || frames.size() - header->json_bytes < header->bulk_bytes) return cut;
  auto json = wire::parse_json(frames.substr(0, header->json_bytes), wire::kReplyJsonBytesMax);
  if (!json.ok()) return json.status();
  std::string_view bulk = frames.substr(header->json_bytes, header->bulk_bytes);
  frames.remove_prefix(header->json_bytes + header->bulk_bytes);
  const auto specs = wire::array_specs(*json, header->bulk_bytes);
  const auto name = wire::string_field(*json, "scene", 64);
  const auto session = wire::string_field(*json, "session", 16);
  const auto step = wire::integer_field(*json, "step", 0, wire::kStepMax);
  for (const Status& status : {specs.status(), name.status(), session.status(), step.status()})
    if (!status.ok()) return status;
  if (!json->contains("answer")) return {Code::io_error, "it holds no answer"};
  std::vector<wire::Array> arrays;
  for (const wire::ArraySpec& spec : *specs) {
    arrays.push_back({spec.name, spec.dtype, spec.shape, {}});
    arrays.back().bytes.assign(bytes_of(bulk.substr(0, spec.bytes)));
    bulk.remove_prefix(spec.bytes);
  }
  scene = *name;
  answers.step = *step;
  answers.sessions.push_back(*session);
  answers.json = json->at("answer");
  answers.arrays.push_back(std::move(arrays));
  return {};
}

bool write_at(int file, std::string_view bytes) {
  off_t at = 0;
  while (!bytes.empty()) {
    const ssize_t count = ::pwrite(file, bytes.data(), bytes.size(), at);
    if (count < 0 && errno == EINTR) continue;
    if (count <= 0) return false;
    bytes.remove_prefix(static_cast<std::size_t>(count));
    at += count;
  }
  return true;
}

// Content of a file of this user that is younger than the longest deadline; else empty.
std::string read_own(const std::string& path) {
  const auto file = open_own_file(path, O_RDONLY | O_CLOEXEC);
  if (!file.ok()) return "";
  struct stat info {};
  std::string bytes;
  if (::fstat(*file, &info) == 0 && std::difftime(std::time(nullptr), info.st_mtime) <= wire::kDeadlineSecondsMax) {
    bytes.resize(static_cast<std::size_t>(info.st_size));
    std::size_t got = 0;
    for (ssize_t count = 1; got < bytes.size() && count > 0;
         got += static_cast<std::size_t>(std::max<ssize_t>(count, 0)))
      count = ::read(*file, bytes.data() + got, bytes.size() - got);
    bytes.resize(got);
  }
  ::close(*file);
  return bytes;
}

}  // namespace

KeptAnswers::KeptAnswers(std::string directory, bool restarted) : directory_(std::move(directory)) {
  if (directory_.empty()) return;
  std::error_code error;
  for (const auto& entry : std::filesystem::directory_iterator(directory_, error)) {
    const std::string found = entry.path().string();
    if (!entry.path().filename().string().starts_with(kPrefix)) continue;
    if (restarted)
      read(found);
    else
      ::unlink(found.c_str());
  }
}

std::string KeptAnswers::path(const std::string& scene, int which) const {
  return join_path(directory_, fmt::format("{}{}.{}", kPrefix, scene, which));
}

void KeptAnswers::read(const std::string& path) {
  const std::string bytes = read_own(path);
  if (bytes.empty()) {
    ::unlink(path.c_str());
    return;
  }
  if (bytes.size() < kHeadBytes) return;
  std::string_view frames = bytes;
  const std::uint64_t size = number_at(frames), sum = number_at(frames.substr(8));
  frames.remove_prefix(kHeadBytes);
  if (size > frames.size() || checksum(frames.substr(0, size)) != sum) return;  // being written when the process died
  frames = frames.substr(0, size);
  std::string scene;
  MemberAnswers answers;
  while (!frames.empty())
    if (const Status status = decode_member(frames, scene, answers); !status.ok()) {
      spdlog::warn("{} is not used: {}", path, status.message());
      return;
    }
  const auto known = before_.find(scene);
  if (known != before_.end() && known->second.step >= answers.step) return;
  // The other file has the older step, so that one is overwritten next.
  next_[scene] = path.ends_with('0') ? 1 : 0;
  before_[scene] = std::move(answers);
}

void KeptAnswers::keep(const std::string& scene, const MemberAnswers& answers) {
  before_.erase(scene);
  if (directory_.empty()) return;
  int& which = next_[scene];
  const std::string to = path(scene, which);
  const auto file = open_own_file(to, O_WRONLY | O_CREAT | O_CLOEXEC);
  std::string fault = file.status().message();
  if (file.ok()) {
    if (!write_at(*file, encode(scene, answers))) fault = fmt::format("{}: {}", to, std::strerror(errno));
    ::close(*file);
  }
  if (fault.empty()) {
    which = 1 - which;
    return;
  }
  ::unlink(to.c_str());
  if (!std::exchange(fault_told_, true))
    spdlog::warn("{}; members that wait for an answer when this service dies won't get it", fault);
}

const MemberAnswers* KeptAnswers::before(const std::string& scene) const {
  const auto found = before_.find(scene);
  return found == before_.end() ? nullptr : &found->second;
}

void KeptAnswers::forget(const std::string& scene) {
  before_.erase(scene);
  if (directory_.empty() || next_.erase(scene) == 0) return;
  for (const int which : {0, 1}) ::unlink(path(scene, which).c_str());
}

void KeptAnswers::forget_all() {
  while (!next_.empty()) forget(std::string(next_.begin()->first));
}

}  // namespace rcb::net
