#include "client/cli/print/output.hpp"

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <utility>

#include <fmt/format.h>
#include <poll.h>
#include <unistd.h>

#include "common/base/clock.hpp"
#include "common/base/text.hpp"

namespace rcb::cli {
namespace {

using Json = nlohmann::ordered_json;

constexpr double kProgressSeconds = 0.1;
constexpr std::uint64_t kBarCells = 24;
constexpr const char* kClearLine = "\r\033[K";

Progress* g_progress = nullptr;  // the newest one

bool colours() {
  const char* off = std::getenv("NO_COLOR");
  return isatty(STDOUT_FILENO) != 0 && (off == nullptr || *off == '\0');
}

void put(std::FILE* stream, const std::string& text) { std::fwrite(text.data(), 1, text.size(), stream); }

std::string padded(const std::string& text, std::size_t width, Table::Align align) {
  const std::string space(width > text.size() ? width - text.size() : 0, ' ');
  return align == Table::Align::right ? space + text : text + space;
}

std::string trimmed(std::string line) {
  line.erase(line.find_last_not_of(' ') + 1);
  return line;
}

}  // namespace

void Table::row(std::vector<std::string> cells) {
  cells.resize(columns_.size());
  rows_.push_back(std::move(cells));
}

void Table::print() {
  const bool first = width_.empty();
  width_.resize(columns_.size());
  for (std::size_t c = 0; c < columns_.size(); ++c) {
    width_[c] = std::max(width_[c], columns_[c].title.size());
    for (const auto& cells : rows_) width_[c] = std::max(width_[c], cells[c].size());
  }
  const auto line = [this](const auto& text_of_column) {
    std::string text;
    for (std::size_t c = 0; c < columns_.size(); ++c)
      text += (c == 0 ? "" : "  ") + padded(text_of_column(c), width_[c], columns_[c].align);
    return trimmed(text);
  };
  if (first) {
    const std::string header = line([this](std::size_t c) { return columns_[c].title; });
    print_line(colours() ? "\033[1m" + header + "\033[0m" : header);
  }
  for (const auto& cells : rows_) print_line(line([&cells](std::size_t c) { return cells[c]; }));
  rows_.clear();
}

void Facts::print() const {
  std::size_t width = 0;
  for (const auto& [name, value] : lines_) width = std::max(width, name.size());
  for (const auto& [name, value] : lines_) print_line(padded(name, width, Table::Align::left) + "  " + value);
}

std::string number(double value) {
  constexpr double kPlainMax = 1e7;  // larger numbers are written as 1.234e+07
  const double size = std::fabs(value);
  if (size < kPlainMax && (size >= 1000 || std::trunc(value) == value)) return fmt::format("{:.0f}", value + 0.0);
  return fmt::format("{:.4g}", value);
}

std::string size(double bytes) {
  constexpr const char* kUnits[] = {"bytes", "KiB", "MiB", "GiB", "TiB"};
  std::size_t unit = 0;
  for (; bytes >= 1024 && unit + 1 < std::size(kUnits); ++unit) bytes /= 1024;
  return fmt::format("{} {}", bytes < 1000 ? fmt::format("{:.3g}", bytes) : fmt::format("{:.0f}", bytes), kUnits[unit]);
}

std::string milliseconds(double seconds) { return fmt::format("{:.3g}", seconds * 1000); }
std::string percent(double share) { return fmt::format("{:.3g} %", share * 100); }

std::string duration(double seconds) {
  const auto whole = static_cast<std::int64_t>(seconds);
  const std::string clock = fmt::format("{:02}:{:02}:{:02}", whole / 3600 % 24, whole / 60 % 60, whole % 60);
  return whole < 86400 ? clock : fmt::format("{} d {}", whole / 86400, clock);
}

std::string text_of(const Json& value) {
  if (value.is_null()) return "-";
  if (value.is_string()) return escape_controls(value.get<std::string>());
  if (value.is_boolean()) return value.get<bool>() ? "yes" : "no";
  if (value.is_number_float()) return number(value.get<double>());
  if (value.is_array()) {
    std::string text;
    for (const Json& item : value) text += (text.empty() ? "" : " ") + text_of(item);
    return text.empty() ? "-" : text;
  }
  return value.dump(-1, ' ', false, Json::error_handler_t::replace);
}

std::string text_of(const Json& object, const char* field) {
  const auto found = object.find(field);
  return found == object.end() ? "-" : text_of(*found);
}

std::string holders_text(const Json& scene) {
  const std::size_t named = scene.value("holders", Json::array()).size();
  return text_of(scene, "holders") + and_more(std::max(scene.value("holders_count", named), named) - named);
}

std::string warning(const std::string& text) { return colours() ? "\033[31m" + text + "\033[0m" : text; }

void print_line(const std::string& line) {
  Progress::make_way();
  put(stdout, line + "\n");
}

void print_json(const Json& document) {
  Progress::make_way();
  put(stdout, document.dump(-1, ' ', false, Json::error_handler_t::replace) + "\n");
}

// Control characters are escaped, since the text may come from a service, a file or a log.
void note(const std::string& text) {
  Progress::make_way();
  put(stderr, "rcbctl: " + escape_controls(text, "\n\t") + "\n");
}

int print_failure(const Status& status, bool json) {
  const int code = exit_code(status.code());
  note(status.message());
  if (!status.hint().empty()) note("hint: " + status.hint());
  if (json)
    print_json({{"failure",
                 {{"code", code_name(status.code())},
                  {"message", status.message()},
                  {"hint", status.hint()},
                  {"exit", code}}}});
  return code;
}

bool reader_gone() {
  pollfd out{STDOUT_FILENO, 0, 0};
  return poll(&out, 1, 0) > 0 && (out.revents & (POLLERR | POLLHUP)) != 0;
}

bool output_cut_off() { return std::ferror(stdout) != 0 && reader_gone(); }

Status flush_output() {
  const bool flushed = std::fflush(stdout) == 0;
  const int error = flushed ? 0 : errno;
  if ((flushed && std::ferror(stdout) == 0) || reader_gone()) return {};
  return {Code::io_error, "standard output can't be written",
          error == EBADF ? "it is closed" : "is there room where it goes?"};
}

Progress::Progress(const std::string& title)
    : title_(escape_controls(title)),
      outer_(std::exchange(g_progress, this)),
      terminal_(isatty(STDERR_FILENO) != 0),
      text_(title_),
      since_(SteadyClock().seconds()) {}

Progress::~Progress() {
  clear();
  g_progress = outer_;
}

void Progress::put_line(const std::string& text) {
  drawn_ = SteadyClock().seconds();
  shown_ = true;
  put(stderr, kClearLine + text);
  std::fflush(stderr);
}

void Progress::show(const std::string& text) {
  if (!terminal_) return;
  text_ = text;
  since_ = SteadyClock().seconds();
  if (!shown_ || since_ - drawn_ >= kProgressSeconds) put_line(text);
}

void Progress::tick() {
  if (g_progress == nullptr || !g_progress->terminal_ || g_progress->text_.empty()) return;
  const double now = SteadyClock().seconds();
  const double stood = now - g_progress->since_;
  if (stood >= 1 && now - g_progress->drawn_ >= kProgressSeconds)
    g_progress->put_line(fmt::format("{} ({:.0f} s)", g_progress->text_, std::floor(stood)));
}

bool Progress::any() { return g_progress != nullptr; }

void Progress::make_way() {
  if (g_progress != nullptr) g_progress->clear_line();
}

void Progress::stage(const std::string& what) {
  clear();
  show(fmt::format("{}: {} ...", title_, escape_controls(what)));
}

void Progress::seconds(double waited) { show(fmt::format("{} ... {:.0f} s", title_, waited)); }

void Progress::at(std::uint64_t done, std::uint64_t total, const std::string& remark) {
  if (total == 0) return show(fmt::format("{}: {} {}", title_, done, remark));
  const std::uint64_t full = std::min(kBarCells, done * kBarCells / total);
  show(fmt::format("{} [{}{}] {}/{} {}", title_, std::string(full, '#'), std::string(kBarCells - full, '.'), done,
                   total, remark));
}

void Progress::clear() {
  clear_line();
  text_.clear();
}

void Progress::clear_line() {
  if (std::exchange(shown_, false)) put(stderr, kClearLine);
}

}  // namespace rcb::cli
