// All that rcbctl prints: tables, JSON, notes, progress. Data goes to stdout, everything else to stderr.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include <nlohmann/json.hpp>

#include "common/base/status.hpp"

namespace rcb::cli {

// Columns of text, aligned; numbers to the right.
class Table {
 public:
  enum class Align { left, right };
  struct Column {
    std::string title;
    Align align = Align::right;
  };

  explicit Table(std::vector<Column> columns) : columns_(std::move(columns)) {}
  void row(std::vector<std::string> cells);  // missing cells are empty
  // The rows since the last call; the header before the first.
  void print();

 private:
  std::vector<Column> columns_;
  std::vector<std::vector<std::string>> rows_;
  std::vector<std::size_t> width_;
};

// "name   value" lines, the values in one column.
class Facts {
 public:
  void add(std::string name, std::string value) { lines_.emplace_back(std::move(name), std::move(value)); }
  void print() const;

 private:
  std::vector<std::pair<std::string, std::string>> lines_;
};

// Four significant digits, or a whole number: for people; --json has them all.
std::string number(double value);
std::string size(double bytes);            // "1.5 MiB"
std::string milliseconds(double seconds);  // "12.3"
std::string duration(double seconds);      // "3 d 04:05:06", "04:05:06"
std::string percent(double share);         // "1.25 %"
// A field's value for people: numbers short, null as "-", strings bare, arrays with spaces between.
std::string text_of(const nlohmann::ordered_json& value);
std::string text_of(const nlohmann::ordered_json& object, const char* field);

// In red, where stdout is a terminal.
std::string warning(const std::string& text);

void print_line(const std::string& line);
void print_json(const nlohmann::ordered_json& document);
// A remark, on stderr.
void note(const std::string& text);
// On stderr; with json also as a document on stdout. Returns the exit code.
int print_failure(const Status& status, bool json);

// stdout is complete, or its reader wants no more. Errors: io_error where it could not be written (a full disk).
Status flush_output();
// stdout's reader, `head` or a pager, has closed it.
bool reader_gone();
// ... before all was written.
bool output_cut_off();

// A line on a terminal's stderr that is written over; nothing elsewhere.
class Progress {
 public:
  explicit Progress(std::string title);
  ~Progress() { clear(); }
  Progress(const Progress&) = delete;
  Progress& operator=(const Progress&) = delete;
  void seconds(double waited);
  void at(std::uint64_t done, std::uint64_t total, const std::string& remark);
  void clear();

 private:
  void show(const std::string& text);

  std::string title_;
  bool terminal_;
  bool shown_ = false;
  double last_ = 0;
};

}  // namespace rcb::cli
