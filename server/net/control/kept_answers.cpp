#include "server/net/control/kept_answers.hpp"

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <ctime>
#include <span>
#include <string_view>
#include <utility>

#include <fcntl.h>
#include <fmt/format.h>
#include <spdlog/spdlog.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/files/own_files.hpp"
#include "common/files/paths.hpp"
#include "common/files/read_write.hpp"
#include "common/wire/frame.hpp"
#include "common/wire/limits.hpp"
#include "server/net/sockets/file_thread.hpp"

namespace rcb::net {
namespace {

constexpr std::string_view kPrefix = "answers.";
constexpr std::size_t kHeadBytes = 16;  // byte count and XXH3-64 of what follows

std::span<const std::byte> bytes_of(std::string_view text) { return std::as_bytes(std::span(text)); }

std::string_view text_of(std::span<const std::byte> bytes) {
  return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
}

std::string number_bytes(std::uint64_t value) { return std::string(text_of(wire::BulkChecksum::encode(value))); }

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

// Writes one frame a member, as it would be sent, then their head: without a copy of the arrays, which may be large.
bool write_answers(int file, const std::string& scene, const MemberAnswers& answers) {
  std::uint64_t size = 0;
  wire::BulkChecksum sum;
  const auto write = [&](std::string_view bytes) {
    sum.add(bytes_of(bytes));
    size += bytes.size();
    return write_all(file, bytes);
  };
  if (::lseek(file, kHeadBytes, SEEK_SET) < 0) return false;
  for (std::size_t member = 0; member < answers.sessions.size(); ++member) {
    std::vector<const wire::Array*> kept;
    std::vector<wire::Array> told;  // the same without their bytes
    wire::FrameHeader header;
    header.type = wire::FrameType::reply;
    header.request = member;
    for (const auto* arrays : {&answers.arrays[member], &answers.cuts})
      for (const wire::Array& array : *arrays) {
        if (array.name.starts_with("place_")) continue;
        kept.push_back(&array);
        told.push_back({array.name, array.dtype, array.shape, {}});
        header.bulk_bytes += array.bytes.size();
      }
    const wire::Json json{{"scene", scene},
                          {"step", answers.step},
                          {"session", answers.sessions[member]},
                          {"answer", answers.json},
                          {"arrays", wire::describe(told)}};
    if (!write(wire::encode_frame(header, wire::dump_json(json)))) return false;
    for (const wire::Array* array : kept)
      if (!write(text_of(array->bytes.span()))) return false;
  }
  const std::string head = number_bytes(size) + number_bytes(sum.value());
  return ::lseek(file, 0, SEEK_SET) == 0 && write_all(file, head);
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

// What the head of a file says that it holds, with the head, if the file is this user's and younger than the longest
// deadline; else empty. Whatever else is in the file may be of any size.
std::string read_own(const std::string& path) {
  const auto file = open_own_file(path, O_RDONLY | O_CLOEXEC);
  if (!file.ok()) return "";
  struct stat info {};
  if (::fstat(file->get(), &info) != 0 || std::difftime(std::time(nullptr), info.st_mtime) > wire::kDeadlineSecondsMax)
    return "";
  const std::string head = read_some(file->get(), kHeadBytes);
  if (head.size() < kHeadBytes || number_at(head) > static_cast<std::uint64_t>(info.st_size)) return head;
  return read_some(file->get(), kHeadBytes + number_at(head));
}

}  // namespace

// On the FileThread, and before the loop starts.
class KeptAnswers::Files {
 public:
  explicit Files(std::string directory) : directory_(std::move(directory)) {}

  void remove_all() {
    for (const std::string& found : list()) ::unlink(found.c_str());
  }
  void read_all(std::map<std::string, MemberAnswers>& into) {
    for (const std::string& found : list()) read(found, into);
  }
  void work(const std::string& scene, const Due& due) {
    if (due.remove && next_.erase(scene) != 0)
      for (const int which : {0, 1}) ::unlink(path(scene, which).c_str());
    if (due.answers) write(scene, *due.answers);
  }

 private:
  std::string path(const std::string& scene, int which) const {
    return join_path(directory_, fmt::format("{}{}.{}", kPrefix, scene, which));
  }

  std::vector<std::string> list() const {
    std::vector<std::string> found;
    std::error_code ignored;
    for (const std::string& name : names_in(directory_, ignored))
      if (name.starts_with(kPrefix)) found.push_back(join_path(directory_, name));
    return found;
  }

  void read(const std::string& path, std::map<std::string, MemberAnswers>& into) {
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
    const auto known = into.find(scene);
    if (known != into.end() && known->second.step >= answers.step) return;
    // The other file has the older step, so that one is overwritten next.
    next_[scene] = path.ends_with('0') ? 1 : 0;
    into[scene] = std::move(answers);
  }

  void write(const std::string& scene, const MemberAnswers& answers) {
    int& which = next_[scene];
    const std::string to = path(scene, which);
    const auto file = open_own_file(to, O_WRONLY | O_CREAT | O_CLOEXEC);
    std::string fault = file.status().message();
    if (file.ok() && !write_answers(file->get(), scene, answers))
      fault = fmt::format("{}: {}", to, std::strerror(errno));
    if (fault.empty()) {
      which = 1 - which;
      return;
    }
    ::unlink(to.c_str());
    if (!std::exchange(fault_told_, true))
      spdlog::warn("{}; members that wait for an answer when this service dies won't get it", fault);
  }

  std::string directory_;
  std::map<std::string, int> next_;  // which of the two files is written next, by scene
  bool fault_told_ = false;
};

KeptAnswers::KeptAnswers(asio::io_context& context, std::string directory, bool restarted) : context_(context) {
  if (directory.empty()) return;
  files_ = std::make_shared<Files>(std::move(directory));
  if (restarted)
    files_->read_all(before_);
  else
    files_->remove_all();
  for (const auto& [scene, answers] : before_) kept_.insert(scene);
}

KeptAnswers::~KeptAnswers() = default;

void KeptAnswers::keep(const std::string& scene, std::shared_ptr<const MemberAnswers> answers,
                       std::function<void()> then) {
  before_.erase(scene);
  if (!files_) return then();
  kept_.insert(scene);
  Due& due = due_[scene];
  due.answers = std::move(answers);
  due.number = ++number_;
  work();
  if (late_ || !working_) return then();
  Waiting& waiting = waiting_.emplace_back(context_, number_, std::move(then));
  waiting.timer.expires_after(duration_of(kWaitSeconds));
  waiting.timer.async_wait([this, number = number_, there = std::weak_ptr(there_)](error_code error) {
    if (!error && !there.expired() && !waiting_.empty() && waiting_.front().number <= number) late();
  });
}

// One job at a time does whatever is due when it begins.
void KeptAnswers::work() {
  if (working_ || due_.empty()) return;
  auto job = std::make_shared<std::map<std::string, Due>>(std::move(due_));
  due_.clear();
  const std::uint64_t upto = number_;
  const Status begun = FileThread::of(context_).run(
      [files = files_, job] {
        for (const auto& [scene, due] : *job) files->work(scene, due);
      },
      [this, upto, there = std::weak_ptr(there_)] {
        if (there.expired()) return;
        working_ = false;
        if (std::exchange(late_, false)) spdlog::info("the members' answers are kept in the data directory again");
        let_go(upto);
        work();
      });
  working_ = begun.ok();
  if (begun.ok()) return;
  due_ = std::move(*job);  // with what comes next
  if (!std::exchange(late_, true))
    spdlog::warn("{}; members that wait for an answer when this service dies won't get it", begun.message());
}

void KeptAnswers::let_go(std::uint64_t number) {
  while (!waiting_.empty() && waiting_.front().number <= number) {
    const auto then = std::move(waiting_.front().then);
    waiting_.pop_front();
    then();
  }
}

void KeptAnswers::late() {
  if (!std::exchange(late_, true))
    spdlog::warn(
        "the data directory has taken no answers for {} s; members that wait for one when this service dies "
        "won't get it",
        kWaitSeconds);
  let_go(number_);
}

const MemberAnswers* KeptAnswers::before(const std::string& scene) const {
  const auto found = before_.find(scene);
  return found == before_.end() ? nullptr : &found->second;
}

void KeptAnswers::forget(const std::string& scene) {
  before_.erase(scene);
  if (kept_.erase(scene) == 0) return;
  due_[scene] = {.remove = true, .answers = nullptr, .number = 0};
  work();
}

void KeptAnswers::forget_all() {
  while (!kept_.empty()) forget(std::string(*kept_.begin()));
  let_go(number_);
}

}  // namespace rcb::net
