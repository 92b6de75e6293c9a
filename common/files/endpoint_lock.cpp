#include "common/files/endpoint_lock.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <ctime>
#include <filesystem>
#include <sstream>

#include <fmt/format.h>

#include "common/files/own_files.hpp"
#include "common/files/paths.hpp"

namespace rcb {
namespace {

constexpr std::string_view kEndpointLockFile = "endpoint.lock";
constexpr std::size_t kReasonBytesMax = 300;

std::string one_line(std::string text) {
  std::replace_if(
      text.begin(), text.end(), [](char c) { return static_cast<unsigned char>(c) < ' '; }, ' ');
  return text;
}

Status served_already(const std::string& endpoint) {
  const auto holder = endpoint_holder(endpoint);
  return {Code::busy,
          fmt::format("{} is served already{}", endpoint, holder ? fmt::format(", by {}", describe(*holder)) : ""),
          "use that service, stop it (rcbctl down), or name another endpoint"};
}

}  // namespace

std::string EndpointNote::text() const {
  return fmt::format(
      "process {}\nprogram {}\nendpoint {}\ndata_dir {}\ndeaths {}\nfailures {}\nstart_at_unix {:.3f}\nlast_reason "
      "{}\n",
      process.text(), program, one_line(endpoint), one_line(data_dir), deaths, failures, start_at_unix,
      one_line(last_reason.substr(0, kReasonBytesMax)));
}

EndpointNote EndpointNote::parse(const std::string& text) {
  EndpointNote note;
  std::istringstream lines(text);
  for (std::string line; std::getline(lines, line);) {
    const std::size_t space = std::min(line.find(' '), line.size());
    const std::string name = line.substr(0, space);
    const std::string value = line.substr(std::min(space + 1, line.size()));
    if (name == "process") note.process = ProcessId::parse(value);
    if (name == "program") note.program = value;
    if (name == "endpoint") note.endpoint = value;
    if (name == "data_dir") note.data_dir = value;
    if (name == "deaths") note.deaths = std::atoi(value.c_str());
    if (name == "failures") note.failures = std::atoi(value.c_str());
    if (name == "start_at_unix") note.start_at_unix = std::strtod(value.c_str(), nullptr);
    if (name == "last_reason") note.last_reason = value;
  }
  return note;
}

std::string endpoint_lock_path(std::string_view endpoint) {
  if (endpoint.starts_with("unix:")) return fmt::format("{}.lock", endpoint.substr(5));
  return join_path(data_directory_for(endpoint), kEndpointLockFile);
}

Result<LockFile> take_endpoint(const EndpointNote& note) {
  const std::string path = endpoint_lock_path(note.endpoint);
  // Only the default folder for sockets is made if missing; any other is the user's own.
  const bool is_unix = note.endpoint.starts_with("unix:");
  const std::string folder = is_unix ? default_socket_directory() : data_directory_for(note.endpoint);
  if (!is_unix || note.endpoint == "unix:" + default_socket_path())
    if (Status made = make_private_directory(folder); !made.ok())
      return naming(is_unix ? "--endpoint" : "XDG_STATE_HOME", made);
  auto lock = LockFile::take(path, note.text());
  if (lock.ok()) return lock;
  if (lock.status().code() == Code::busy) return served_already(note.endpoint);
  if (lock.status().code() == Code::not_found)
    return Status(Code::io_error, fmt::format("the folder of the socket {} isn't there", note.endpoint),
                  "make it, or name another endpoint");
  const Status why = lock.status();
  if (is_unix && (why.hint().empty() || !is_own_directory(std::filesystem::path(path).parent_path())))
    return Status(why.code(), why.message(), "choose a folder of yours for the socket, with --endpoint");
  return lock;
}

Result<LockFile> take_data_directory(const EndpointNote& note) {
  const std::string path = join_path(note.data_dir, kLockFile);
  auto lock = LockFile::take(path, note.text());
  if (lock.ok()) return lock;
  if (const Status why = lock.status(); why.code() != Code::busy)
    return Status(why.code(), why.message(), why.hint().empty() ? "name another place with --data-dir" : why.hint());
  const auto holder = LockFile::holder(path);
  return Status(Code::busy,
                fmt::format("the data directory {} is in use by {}", note.data_dir,
                            holder ? EndpointNote::parse(*holder).endpoint : "a live service"),
                "stop that service (rcbctl down), or name another --data-dir");
}

bool held_by_supervisor(const std::string& lock_path) {
  const char* supervisor = std::getenv(kSupervisorVariable);
  const auto note = LockFile::holder(lock_path);
  return supervisor != nullptr && note && EndpointNote::parse(*note).process == ProcessId::parse(supervisor);
}

std::optional<EndpointNote> endpoint_holder(std::string_view endpoint) {
  const auto note = LockFile::holder(endpoint_lock_path(endpoint));
  if (!note) return std::nullopt;
  return EndpointNote::parse(*note);
}

std::string describe(const EndpointNote& note) {
  std::string text = fmt::format("pid {} ({}), data directory {}", note.process.pid, note.program, note.data_dir);
  if (note.start_at_unix == 0) return text;
  const double left = std::max(0.0, note.start_at_unix - static_cast<double>(std::time(nullptr)));
  return fmt::format("{}, which starts it again in {} s (it has died {} times{}{})", text, std::ceil(left), note.deaths,
                     note.last_reason.empty() ? "" : ", at last: ", note.last_reason);
}

}  // namespace rcb
