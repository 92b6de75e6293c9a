#include "client/lib/connect/endpoint_file.hpp"

#include <cstdio>

#include <fcntl.h>
#include <fmt/format.h>

#include "common/base/text.hpp"
#include "common/files/own_files.hpp"
#include "common/files/read_write.hpp"
#include "common/wire/field_reader.hpp"
#include "common/wire/message.hpp"

namespace rcb::client {
namespace {

constexpr std::size_t kBytesMax = 16384;

}  // namespace

Result<EndpointFile> read_endpoint_file(const std::string& path) {
  const auto opened = open_own_file(path, O_RDONLY);  // what others could write might name any service, and any token
  if (!opened.ok() && opened.status().code() != Code::not_found)
    return Status(opened.status().code(), opened.status().message(),
                  "name the file that your own 'rcbctl up --publish' writes");
  if (!opened.ok())
    return Status(Code::unavailable, fmt::format("{} isn't there: no service has written it, or it has ended", path),
                  "start one: rcbctl up --publish FILE");
  const auto json = wire::parse_json(read_some(opened->get(), kBytesMax));
  const Status foreign(Code::invalid_argument, fmt::format("{} is no file that 'rcbctl up --publish' writes", path));
  if (!json.ok()) return foreign;
  wire::FieldReader fields(*json);
  EndpointFile file{fields.text("endpoint", 4096), fields.text("host", 256), fields.text("job", 256),
                    fields.text("token_file", 4096)};
  if (!fields.status().ok() || file.endpoint.starts_with("file:") || has_controls(file.host) || has_controls(file.job))
    return foreign;
  return file;
}

Status check_endpoint_place(const std::string& path) {
  const auto there = read_endpoint_file(path);
  if (there.ok() || there.status().code() == Code::unavailable) return {};
  return {there.status().code(), there.status().message(), "remove it, or publish in another place"};
}

Status write_endpoint_file(const std::string& path, const EndpointFile& file) {
  if (Status status = check_endpoint_place(path); !status.ok()) return status;
  const wire::Json json{
      {"endpoint", file.endpoint}, {"host", file.host}, {"job", file.job}, {"token_file", file.token_file}};
  return write_own_file(path, wire::dump_json(json) + "\n");
}

void remove_endpoint_file(const std::string& path, const EndpointFile& own) {
  const auto there = read_endpoint_file(path);
  if (there.ok() && there->host == own.host && there->job == own.job && there->endpoint == own.endpoint)
    std::remove(path.c_str());
}

}  // namespace rcb::client
