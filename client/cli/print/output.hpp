// Room `print`: how rcbctl shows tables, curves, plots, CSV and progress. It never contacts a service.
//
// All that rcbctl prints: tables, JSON, notes, progress. Data goes to stdout, everything else to stderr.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include <nlohmann/json.hpp>

#include "common/base/status.hpp"

namespace rcb::cli {

// Aligned columns of text; numbers to the right.
class Table {
 public:
  enum class Align { left, right };
  struct Column {
    std::string title;
    Align align = Align::right;
  };

  explicit Table(std::vector<Column> columns) : columns_(std::move(columns)) {}
  void row(std::vector<std::string> cells);  // missing cells are empty
  // Prints the rows added since the last call; the first call also prints the header.
  void print();

 private:
  std::vector<Column> columns_;
  std::vector<std::vector<std::string>> rows_;
  std::vector<std::size_t> width_;
};

// Lines "name   value", with the values aligned.
class Facts {
 public:
  void add(std::string name, std::string value) { lines_.emplace_back(std::move(name), std::move(value)); }
  void print() const;

 private:
  std::vector<std::pair<std::string, std::string>> lines_;
};

// For people: four significant digits, or a whole number. --json has all digits.
std::string number(double value);
std::string size(double bytes);            // "1.5 MiB"
std::string milliseconds(double seconds);  // "12.3"
std::string duration(double seconds);      // "3 d 04:05:06", "04:05:06"
std::string percent(double share);         // "1.25 %"
// A field's value for people: short numbers, null as "-", strings without quotes, arrays separated by spaces.
std::string text_of(const nlohmann::ordered_json& value);
std::string text_of(const nlohmann::ordered_json& object, const char* field);
// Who has the scene open, of scene.show or status; the service names a few of many.
std::string holders_text(const nlohmann::ordered_json& scene);

// In red if stdout is a terminal.
std::string warning(const std::string& text);

void print_line(const std::string& line);
void print_json(const nlohmann::ordered_json& document);
// Prints a remark on stderr.
void note(const std::string& text);
// Prints the failure on stderr, with json also as a document on stdout. Returns the exit code.
int print_failure(const Status& status, bool json);

// Flushes stdout. Ok also if its reader has closed it. Errors: io_error if it can't be written (a full disk).
Status flush_output();
// Whether stdout's reader, such as `head` or a pager, has closed it.
bool reader_gone();
// Whether it did so before everything was written.
bool output_cut_off();

// A progress line that overwrites itself, if stderr is a terminal; else nothing. What else is written meanwhile
// takes its place.
class Progress {
 public:
  explicit Progress(const std::string& title);
  ~Progress();
  Progress(const Progress&) = delete;
  Progress& operator=(const Progress&) = delete;
  // What is being done now, shown at once.
  void stage(const std::string& what);
  void seconds(double waited);
  // total: 0 if it isn't known.
  void at(std::uint64_t done, std::uint64_t total, const std::string& remark);
  void clear();
  // To be called while the program waits: once the newest text has stood for a second, shows it, and for how long.
  static void tick();
  static bool any();
  // Before anything else is written, which may go to the same terminal.
  static void make_way();

 private:
  void show(const std::string& text);
  void put_line(const std::string& text);
  void clear_line();

  std::string title_;
  Progress* outer_;  // the one before this one
  bool terminal_;
  bool shown_ = false;
  std::string text_;  // what is being done; at first the title
  double since_;      // since when
  double drawn_ = 0;  // when the line was last drawn
};

}  // namespace rcb::cli
