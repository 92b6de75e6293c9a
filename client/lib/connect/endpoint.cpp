#include "client/lib/connect/endpoint.hpp"

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <optional>

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>

#include "client/lib/connect/endpoint_file.hpp"
#include "common/base/host_port.hpp"
#include "common/files/descriptor.hpp"
#include "common/files/paths.hpp"
#include "common/files/read_write.hpp"

namespace rcb::client {
namespace {

constexpr std::size_t kTokenBytesMax = 1024;

std::string variable(const char* name) {
  const char* value = std::getenv(name);
  return value == nullptr ? std::string{} : value;
}

Status bad_endpoint(std::string_view text, std::string_view why) {
  return {
      Code::invalid_argument, fmt::format("endpoint '{}': {}", text, why),
      "an endpoint is unix:PATH or HOST:PORT, such as unix:/tmp/rcbd.sock or 127.0.0.1:7470; file:PATH for clients"};
}

Result<Endpoint> unix_endpoint(std::string_view text, std::string_view path) {
  if (path.empty()) return bad_endpoint(text, "no path");
  // Logs, and the files that tell where a service is, give a line to an endpoint.
  for (const char c : path)
    if (static_cast<unsigned char>(c) < ' ' || c == '\x7f') return bad_endpoint(text, "a control character inside");
  std::error_code error;
  const auto absolute = std::filesystem::absolute(std::filesystem::path(path), error);
  if (error) return bad_endpoint(text, error.message());
  Endpoint endpoint;
  endpoint.path = absolute.lexically_normal().string();
  if (endpoint.path.size() > kSocketPathMax)
    return bad_endpoint(
        text, fmt::format("the path has {} bytes, a socket's has at most {}", endpoint.path.size(), kSocketPathMax));
  return endpoint;
}

// The first line of a file; nothing if the file can't be read, or if the line is empty or too long for a token.
std::optional<std::string> first_line(const std::string& path) {
  const Descriptor file(
      ::open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK));  // a FIFO would be waited for for ever
  struct stat about {};
  if (!file.open() || ::fstat(file.get(), &about) != 0 || !S_ISREG(about.st_mode)) return std::nullopt;
  std::string text = read_some(file.get(), kTokenBytesMax + 1);
  text = text.substr(0, text.find_first_of("\r\n"));
  if (text.empty() || text.size() > kTokenBytesMax) return std::nullopt;
  return text;
}

// Whether clients on other machines don't reach it.
bool of_one_machine(const Endpoint& endpoint) {
  return endpoint.is_unix || endpoint.host.starts_with("127.") || endpoint.host == "localhost" ||
         endpoint.host == "::1";
}

Result<Endpoint> published_endpoint(const std::string& path) {
  const auto file = read_endpoint_file(path);
  if (!file) return file.status();
  auto endpoint = parse_endpoint(file->endpoint);
  if (!endpoint) return endpoint.status();
  if (of_one_machine(*endpoint) && file->host != host_name())
    return Status(Code::unavailable,
                  fmt::format("{} names {} on host {}, which is not this one", path, endpoint->text(), file->host),
                  "start the service with --endpoint HOST:PORT for clients on other machines");
  endpoint->published = fmt::format("the service that wrote {} (job {} on host {})", path, file->job, file->host);
  endpoint->token_file = file->token_file;
  return endpoint;
}

}  // namespace

std::string Endpoint::text() const {
  if (is_unix) return "unix:" + path;
  return join_host_port(host, port);
}

Result<Endpoint> parse_endpoint(std::string_view text) {
  if (text.starts_with("unix:")) return unix_endpoint(text, text.substr(5));
  if (text.find('/') != std::string_view::npos) return unix_endpoint(text, text);
  if (text.find(':') == std::string_view::npos) return bad_endpoint(text, "no port");
  const auto [host, digits, brackets] = split_host_port(text);
  if (!brackets && host.find_first_of(":[]") != std::string_view::npos)
    return bad_endpoint(text, "an IPv6 address stands in brackets, as in [::1]:7470");
  if (host.empty() || host.size() > 253) return bad_endpoint(text, "no host");
  for (const char c : host)
    if (static_cast<unsigned char>(c) <= ' ' || c == '\x7f') return bad_endpoint(text, "a space in the host's name");
  Endpoint endpoint;
  endpoint.is_unix = false;
  endpoint.port = port_number(digits).value_or(0);
  if (endpoint.port == 0) return bad_endpoint(text, "the port is a number of 1 to 65535");
  endpoint.host = host;
  for (char& c : endpoint.host)  // host names ignore case
    if (c >= 'A' && c <= 'Z') c = static_cast<char>(c - 'A' + 'a');
  return endpoint;
}

Result<std::vector<Endpoint>> endpoints_to_try(const std::string& given) {
  const std::string told = given.empty() ? variable("RCBD_ENDPOINT") : given;
  std::vector<Endpoint> endpoints;
  if (told.starts_with(kFilePrefix)) {
    auto endpoint = published_endpoint(told.substr(kFilePrefix.size()));
    if (!endpoint) return endpoint.status();
    return std::vector{std::move(*endpoint)};
  }
  auto first = parse_endpoint(told.empty() ? "unix:" + default_socket_path() : told);
  if (!first && !told.empty()) return first.status();
  if (first) endpoints.push_back(*first);
  if (told.empty()) endpoints.push_back({false, {}, "127.0.0.1", kDefaultPort});
  return endpoints;
}

Result<Endpoint> endpoint_to_serve(const std::string& given) {
  const std::string told = given.empty() ? variable("RCBD_ENDPOINT") : given;
  if (told.starts_with(kFilePrefix))
    return Status(Code::invalid_argument, fmt::format("a service can't be started at {}", told),
                  fmt::format("for example: rcbctl up --endpoint HOST:{} --publish {}", kDefaultPort,
                              told.substr(kFilePrefix.size())));
  return parse_endpoint(told.empty() ? "unix:" + default_socket_path() : told);
}

std::string data_directory(const Endpoint& endpoint) { return data_directory_for(endpoint.text()); }
std::string token_path(const Endpoint& endpoint) { return join_path(data_directory(endpoint), kTokenFile); }

Result<std::vector<std::string>> tokens_for(const Endpoint& endpoint, const std::string& given, bool this_machine) {
  if (!given.empty()) return std::vector{given};
  if (const std::string token = variable("RCBD_TOKEN"); !token.empty()) return std::vector{token};
  if (const std::string path = variable("RCBD_TOKEN_FILE"); !path.empty()) {
    if (const auto token = first_line(path)) return std::vector{*token};
    return Status(Code::invalid_argument, fmt::format("no token can be read from '{}'", path),
                  "RCBD_TOKEN_FILE names the file 'token' of the service's data directory");
  }
  std::vector<std::string> tokens;
  if (!endpoint.token_file.empty()) {
    if (auto token = first_line(endpoint.token_file))
      tokens.push_back(std::move(*token));
    else if (!this_machine)
      return Status(
          Code::not_authorised,
          fmt::format("{} says that its token is in {}, which can't be read on this machine", endpoint.published,
                      endpoint.token_file),
          "start it with a --data-dir that the machines share, or set RCBD_TOKEN_FILE to a copy of that file");
  }
  if (!this_machine) return tokens;
  // A service that listens on all interfaces is reached by several names; its data directory is named after the one it
  // was started with.
  for (const std::string& host : {endpoint.host, std::string("127.0.0.1"), std::string("localhost"),
                                  std::string("0.0.0.0"), std::string("::1"), std::string("::")}) {
    const auto token = first_line(token_path({false, {}, host, endpoint.port}));
    if (token && std::find(tokens.begin(), tokens.end(), *token) == tokens.end()) tokens.push_back(*token);
  }
  return tokens;
}

}  // namespace rcb::client
