// halo, neighbours: which particles each part needs besides its own, and whose.
#include <algorithm>
#include <charconv>
#include <functional>
#include <iterator>
#include <span>
#include <system_error>
#include <utility>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "client/cli/commands/near.hpp"
#include "client/cli/files/new_files.hpp"
#include "client/cli/interrupt.hpp"
#include "client/cli/print/output.hpp"
#include "client/cli/print/parts_table.hpp"
#include "common/base/axis_names.hpp"
#include "common/files/paths.hpp"
#include "common/io/files/output_file.hpp"

namespace rcb::cli {
namespace {

constexpr std::size_t kTextBytes = std::size_t{1} << 20U;
constexpr std::size_t kRowsAtOnce = 1000;

struct HaloOptions : NearOptions {
  bool held = false;
  std::string out;
};

Status odd_arrays(const char* command) {
  return {Code::protocol_error, fmt::format("the arrays in the answer to {} don't fit", command)};
}

template <typename T>
std::span<const T> values_in(const client::Reply& reply, const char* name) {
  const client::Array* array = reply.find(name);
  if constexpr (std::is_same_v<T, std::int32_t>) return array == nullptr ? std::span<const T>() : array->i4();
  if constexpr (std::is_same_v<T, std::int64_t>) return array == nullptr ? std::span<const T>() : array->i8();
}

// Prints a document with --json whose last field is a list that may be too long for one text.
class LongDocument {
 public:
  LongDocument(const Context& context, const Json& document, const char* list) : context_(context) {
    text_ = document.dump(-1, ' ', false, Json::error_handler_t::replace);
    text_.back() = ',';
    text_ += fmt::format("\"{}\":[", list);
  }
  void add(const std::string& item) {
    if (!first_) text_ += ',';
    first_ = false;
    text_ += item;
    if (text_.size() < kTextBytes) return;
    context_.document_begun = true;
    print_line(std::exchange(text_, {}));
  }
  void end() { print_line(text_ + "]}"); }

 private:
  const Context& context_;
  std::string text_;
  bool first_ = true;
};

// The particles that parts send one another; a row for each pair of parts.
struct Pairs {
  std::size_t parts = 0;
  std::span<const std::int32_t> from, to;
  std::span<const std::int64_t> count;
};

Result<Pairs> pairs_in(const Answer& answer) {
  Pairs pairs{answer.json.at("parts").get<std::size_t>(), values_in<std::int32_t>(answer.reply, "from"),
              values_in<std::int32_t>(answer.reply, "to"), values_in<std::int64_t>(answer.reply, "count")};
  if (pairs.to.size() != pairs.from.size() || pairs.count.size() != pairs.from.size()) return odd_arrays("halo");
  for (const auto list : {pairs.from, pairs.to})
    for (const std::int32_t part : list)
      if (part < 0 || static_cast<std::size_t>(part) >= pairs.parts) return odd_arrays("halo");
  return pairs;
}

void print_pairs(const Pairs& pairs) {
  Table table({{"from"}, {"to"}, {"points"}});
  for (std::size_t k = 0; k < pairs.from.size(); ++k) {
    table.row({std::to_string(pairs.from[k]), std::to_string(pairs.to[k]), std::to_string(pairs.count[k])});
    if ((k + 1) % kRowsAtOnce == 0) table.print();
  }
  table.print();
}

void print_sums(const Pairs& pairs) {
  std::vector<double> sent(pairs.parts), to(pairs.parts), got(pairs.parts), from(pairs.parts);
  for (std::size_t k = 0; k < pairs.from.size(); ++k) {
    const auto sender = static_cast<std::size_t>(pairs.from[k]), receiver = static_cast<std::size_t>(pairs.to[k]);
    sent[sender] += static_cast<double>(pairs.count[k]);
    got[receiver] += static_cast<double>(pairs.count[k]);
    ++to[sender];
    ++from[receiver];
  }
  PartsTable table(pairs.parts);
  table.add("sends", sent);
  table.add("to parts", to);
  table.add("gets", got);
  table.add("from parts", from);
  table.print(got, false);
}

void print_halo(const HaloOptions& options, const Pairs& pairs, const Json& document) {
  if (summarised(pairs.parts, options.all))
    print_sums(pairs);
  else
    print_pairs(pairs);
  print_line("");
  print_line(fmt::format("{} pairs of parts, {} points to send{}; {}", pairs.from.size(), text_of(document, "entries"),
                         document.at("periodic").is_null() ? "" : ", every image counted", near_text(document)));
}

// Whose halo files a folder may hold is decided by their names.
std::string halo_file_name(std::size_t part) { return fmt::format("halo_{}.csv", part); }

// Files of parts that there aren't would be taken for this answer's. Errors: already_exists.
Status check_leftovers(const std::string& directory, std::size_t parts) {
  std::error_code fault;
  for (const std::string& name : names_in(directory, fault)) {
    std::size_t part = 0;
    if (!name.starts_with("halo_")) continue;
    std::from_chars(name.data() + 5, name.data() + name.size(), part);
    if (part >= parts && name == halo_file_name(part))
      return {Code::already_exists, fmt::format("{} holds {}, and there are {} parts", directory, name, parts),
              "remove it, or name another folder"};
  }
  return {};
}

// The entries of all parts, in the order of the sending part.
struct Lists {
  std::span<const std::int64_t> id;
  std::span<const std::int32_t> from, to;
  std::span<const std::int32_t> shift;  // [entries][dims], or empty: 0
  std::size_t dims = 3;
};

Result<Lists> lists_in(const Answer& answer) {
  Lists lists{values_in<std::int64_t>(answer.reply, "id"), values_in<std::int32_t>(answer.reply, "list_from"),
              values_in<std::int32_t>(answer.reply, "list_to"), values_in<std::int32_t>(answer.reply, "shift"),
              answer.json.at("dims").get<std::size_t>()};
  const std::size_t entries = lists.id.size();
  if (lists.from.size() != entries || lists.to.size() != entries || lists.dims < 1 ||
      lists.dims > std::size(kAxisNames) || (!lists.shift.empty() && lists.shift.size() != entries * lists.dims) ||
      !std::ranges::is_sorted(lists.from))
    return odd_arrays("halo");
  return lists;
}

// Writes the entries from `next` on that this part sends.
Status write_list(const Lists& lists, std::int32_t part, std::size_t& next, const std::string& path) {
  auto file = io::OutputFile::create(path);
  if (!file) return file.status();
  std::string text = "id,to";
  for (std::size_t a = 0; a < lists.dims; ++a) text += fmt::format(",shift_{}", kAxisNames[a]);
  text += '\n';
  for (; next < lists.id.size() && lists.from[next] == part; ++next) {
    fmt::format_to(std::back_inserter(text), "{},{}", lists.id[next], lists.to[next]);
    for (std::size_t a = 0; a < lists.dims; ++a)
      fmt::format_to(std::back_inserter(text), ",{}", lists.shift.empty() ? 0 : lists.shift[next * lists.dims + a]);
    text += '\n';
    if (text.size() < kTextBytes) continue;
    if (Status status = file->write(std::exchange(text, {})); !status) return status;
  }
  if (Status status = file->write(text); !status) return status;
  return file->commit();
}

// All of them, or none. Returns their paths.
Result<std::vector<std::string>> write_lists(const Answer& answer, std::size_t parts, const std::string& directory) {
  const auto lists = lists_in(answer);
  if (!lists) return lists.status();
  if (Status status = check_leftovers(directory, parts); !status) return status;
  auto files = NewFiles::begin(directory);
  if (!files) return files.status();
  Progress progress("halo");
  progress.stage("writing");
  std::vector<std::string> names, paths;
  std::size_t next = 0;
  for (std::size_t part = 0; part < parts; ++part) {
    if (interrupted()) return interruption(fmt::format("while {} was written", directory));
    names.push_back(halo_file_name(part));
    paths.push_back(join_path(directory, names.back()));
    const std::string hidden = join_path(files->hidden(), names.back());
    if (Status status = write_list(*lists, static_cast<std::int32_t>(part), next, hidden); !status) return status;
  }
  if (Status status = files->commit(names); !status) return status;
  return paths;
}

// What was asked and what came with it, without the lists.
Json document_of(const Answer& answer, Json arguments) {
  Json document = answer.json;
  document.update(arguments);
  return document;
}

Status halo(const HaloOptions& options, const Context& context) {
  auto arguments = near_json(options);
  if (!arguments) return arguments.status();
  auto client = connect(context);
  if (!client) return client.status();
  Json request = *arguments;
  request["lists"] = !options.out.empty();
  request["held"] = options.held;
  const auto answer = ask_arrays(*client, "halo", request, options.deadline_seconds);
  if (!answer) return answer.status();
  const auto pairs = pairs_in(*answer);
  if (!pairs) return pairs.status();
  Json document = document_of(*answer, std::move(*arguments));
  if (!options.out.empty()) {
    const auto paths = write_lists(*answer, pairs->parts, options.out);
    if (!paths) return paths.status();
    document["files"] = *paths;
  }
  if (!context.json) {
    print_halo(options, *pairs, document);
    if (!options.out.empty()) print_line(fmt::format("{}: halo_0.csv and so on, a file for each part", options.out));
    return {};
  }
  LongDocument out(context, document, "pairs");
  for (std::size_t k = 0; k < pairs->from.size(); ++k)
    out.add(fmt::format(R"({{"from":{},"to":{},"count":{}}})", pairs->from[k], pairs->to[k], pairs->count[k]));
  out.end();
  return {};
}

// By part, its neighbours from offset[part] to offset[part + 1].
struct Neighbours {
  std::span<const std::int64_t> offset;
  std::span<const std::int32_t> part;
  std::span<const std::int32_t> shift;  // [entries][dims], or empty: 0
  std::size_t dims = 3;

  std::size_t parts() const { return offset.size() - 1; }
  std::vector<std::int32_t> shift_of(std::size_t entry) const {
    std::vector<std::int32_t> list(dims, 0);
    for (std::size_t a = 0; a < dims && !shift.empty(); ++a) list[a] = shift[entry * dims + a];
    return list;
  }
  // text(entry) of each neighbour of the part, separated.
  std::string list(std::size_t of, const char* between, const std::function<std::string(std::size_t)>& text) const {
    std::string all;
    for (auto k = static_cast<std::size_t>(offset[of]); k < static_cast<std::size_t>(offset[of + 1]); ++k)
      all += (all.empty() ? "" : between) + text(k);
    return all;
  }
};

Result<Neighbours> neighbours_in(const Answer& answer) {
  Neighbours found{values_in<std::int64_t>(answer.reply, "offset"), values_in<std::int32_t>(answer.reply, "part"),
                   values_in<std::int32_t>(answer.reply, "shift"), answer.json.at("dims").get<std::size_t>()};
  const auto& offset = found.offset;
  if (offset.empty() || offset.front() != 0 || offset.back() != std::ssize(found.part) ||
      !std::ranges::is_sorted(offset) || (!found.shift.empty() && found.shift.size() != found.part.size() * found.dims))
    return odd_arrays("neighbours");
  return found;
}

void print_neighbours(const NearOptions& options, const Neighbours& found) {
  std::vector<double> counts;
  for (std::size_t p = 0; p < found.parts(); ++p)
    counts.push_back(static_cast<double>(found.offset[p + 1] - found.offset[p]));
  if (summarised(found.parts(), options.all)) {
    PartsTable table(found.parts());
    table.add("neighbours", counts);
    return table.print(counts, false);
  }
  Table table({{"part"}, {"count"}, {"neighbours", Table::Align::left}});
  for (std::size_t p = 0; p < found.parts(); ++p) {
    table.row({std::to_string(p), number(counts[p]), found.list(p, " ", [&found](std::size_t k) {
                 const auto shift = found.shift_of(k);
                 const bool moved = std::ranges::any_of(shift, [](int periods) { return periods != 0; });
                 return fmt::format("{}{}", found.part[k], moved ? fmt::format("({})", fmt::join(shift, " ")) : "");
               })});
    if ((p + 1) % kRowsAtOnce == 0) table.print();
  }
  table.print();
  if (!found.shift.empty()) print_line("(1 0 0): reached by what is moved by one period along x");
}

Status neighbours(const NearOptions& options, const Context& context) {
  auto arguments = near_json(options);
  if (!arguments) return arguments.status();
  auto client = connect(context);
  if (!client) return client.status();
  const auto answer = ask_arrays(*client, "neighbours", *arguments, options.deadline_seconds);
  if (!answer) return answer.status();
  const auto found = neighbours_in(*answer);
  if (!found) return found.status();
  const Json document = document_of(*answer, std::move(*arguments));
  if (!context.json) {
    print_neighbours(options, *found);
    print_line(near_text(document));
    return {};
  }
  LongDocument out(context, document, "neighbours");
  for (std::size_t p = 0; p < found->parts(); ++p)
    out.add("[" + found->list(p, ",", [&found](std::size_t k) {
      return fmt::format(R"({{"part":{},"shift":[{}]}})", found->part[k], fmt::join(found->shift_of(k), ","));
    }) + "]");
  out.end();
  return {};
}

}  // namespace

void add_halo_commands(CLI::App& app, Context& context) {
  auto [halos, asked] = add_command(
      app, context,
      {"halo", "How many points each part must send to each other one",
       "  rcbctl halo jet --width 0.05\n  rcbctl halo jet --width 0.05 --periodic 0 0 - 1 1 - --out halos", kAskGroup},
      halo);
  add_near_options(halos, asked);
  add_held(halos, asked.held);
  add_value(halos, "--out", asked.out, kind::text("DIR"),
            "write what part P sends to DIR/halo_P.csv: id, to which part, moved by how many periods; made if missing");
  auto [near, distance] = add_command(
      app, context,
      {"neighbours", "Which parts are near each part", "  rcbctl neighbours jet --width 0.05 --norm euclid", kAskGroup},
      neighbours);
  add_near_options(near, distance);
}

}  // namespace rcb::cli
