#include "tests/bench/measure.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <fstream>

#include <fmt/format.h>
#include <malloc.h>

#include "common/base/clock.hpp"
#include "common/partition/balance/load.hpp"

namespace rcb::bench {
namespace {

constexpr int kTopPadBytes = 64 << 20;

// Local. A field of /proc/self/status, in bytes; 0 where there is none.
std::uint64_t memory_field(const std::string& name) {
  std::ifstream in("/proc/self/status");
  for (std::string line; std::getline(in, line);)
    if (line.starts_with(name + ":")) return 1024 * std::stoull(line.substr(name.size() + 1));
  return 0;
}

// Local. False where the system doesn't let the peak be forgotten.
bool forget_peak_memory() {
  std::ofstream out("/proc/self/clear_refs");
  out << "5";
  out.close();
  return !out.fail();
}

// Of the bit patterns: unlike sums of doubles they may be made in any order, so the compiler uses vectors.
#if defined(__x86_64__)
__attribute__((target_clones("avx2", "default")))
#endif
std::uint64_t
sum_of(const double* values, std::size_t count) {
  std::uint64_t sum = 0;
  for (std::size_t i = 0; i < count; ++i) sum += std::bit_cast<std::uint64_t>(values[i]);
  return sum;
}

// One contender's turn, timed. Collective. The slowest rank's seconds; nullopt if any rank failed.
std::optional<double> turn(comm::Comm& comm, Contender& contender, std::string& failure) {
  static const SteadyClock clock;
  comm.barrier();
  const double begin = clock.seconds();
  const Status status = contender.run();
  comm.barrier();
  // Positive doubles compare as their bits do.
  std::uint64_t bits = std::bit_cast<std::uint64_t>(clock.seconds() - begin);
  comm.all_max({&bits, 1});
  if (comm::agree(comm, status.ok())) return std::bit_cast<double>(bits);
  failure = status.ok() ? "failed on another rank" : status.message();
  return std::nullopt;
}

// Counts what the last run left. Collective.
void judge(comm::Comm& comm, const Problem& problem, Contender& contender, Measurement& out) {
  if (contender.setting().tool == kFloor) return;
  const Answer answer = contender.answer();
  const auto parts = static_cast<std::size_t>(problem.parts);
  std::vector<std::uint64_t> counts(parts + 1, 0);  // the last: of no part that there is
  for (const std::int32_t part : answer.part)
    ++counts[std::min(static_cast<std::size_t>(static_cast<std::uint32_t>(part)), parts)];
  comm.all_sum(counts);
  const std::uint64_t nowhere = counts.back();
  counts.pop_back();
  std::uint64_t held = 0;
  for (const std::uint64_t count : counts) held += count;
  if (nowhere != 0 || held != problem.n) {
    out.failure = fmt::format("{} of {} particles got a part, {} one that there isn't", held, problem.n, nowhere);
    return;
  }
  out.empty_parts = std::max(out.empty_parts, static_cast<std::uint64_t>(std::count(counts.begin(), counts.end(), 0U)));
  const auto loads = partition::summarise_counts(std::move(counts), {});
  out.error = std::max(out.error, loads.error);
  out.imbalance = std::max(out.imbalance, loads.imbalance);
  if (out.hash && out.hash != answer.hash) out.failure = "the hash changed from one repeat to the next";
  out.hash = answer.hash;
  out.cost = answer.cost;
  if (!answer.cost) return;
  std::array<std::uint64_t, 2> passes{answer.cost->reads, answer.cost->bytes};
  comm.all_sum(passes);
  out.cost->reads = passes[0];
  out.cost->bytes = passes[1];
}

// Growth of the resident memory during one run, from a heap that keeps nothing. Collective.
std::optional<double> peak_growth(comm::Comm& comm, const Problem& problem, Contender& contender,
                                  std::string& failure) {
  malloc_trim(0);
  const bool known = forget_peak_memory();
  const std::uint64_t before = memory_field("VmRSS");
  if (!turn(comm, contender, failure)) return std::nullopt;
  const std::uint64_t peak = memory_field("VmHWM");
  std::uint64_t growth = peak > before ? peak - before : 0;
  comm.all_sum({&growth, 1});
  if (!comm::agree(comm, known && before > 0) || problem.n == 0) return std::nullopt;
  return static_cast<double>(growth) / static_cast<double>(problem.n);
}

}  // namespace

std::uint64_t read_doubles(std::span<const double> values) { return sum_of(values.data(), values.size()); }

std::uint64_t read_positions(const particles::ParticleView& particles) {
  std::uint64_t sum = 0;
  for (std::size_t a = 0; a < static_cast<std::size_t>(particles.dims); ++a)
    sum += sum_of(particles.position[a], particles.count);
  return sum;
}

void keep_freed_memory() {
  mallopt(M_MMAP_MAX, 0);         // the threshold itself can't be raised above 32 MiB
  mallopt(M_TRIM_THRESHOLD, -1);  // never
  mallopt(M_TOP_PAD, kTopPadBytes);
}

double median(std::vector<double> values) {
  const std::size_t middle = values.size() / 2;
  std::sort(values.begin(), values.end());
  return values.size() % 2 == 1 ? values[middle] : (values[middle - 1] + values[middle]) / 2;
}

std::vector<Measurement> measure(comm::Comm& comm, const Problem& problem, const Contenders& contenders,
                                 const MeasureOptions& options) {
  std::vector<Contender*> present;
  std::vector<Measurement> results;
  for (const auto& contender : contenders) {
    const Status status = contender->prepare(problem);
    if (status.code() == Code::unsupported) continue;
    Measurement result;
    result.setting = contender->setting();
    if (!comm::agree(comm, status.ok())) result.failure = status.ok() ? "failed on another rank" : status.message();
    present.push_back(contender.get());
    results.push_back(std::move(result));
  }
  const auto each = [&](std::size_t first, const auto& action) {
    for (std::size_t k = 0; k < present.size(); ++k) {
      const std::size_t c = (first + k) % present.size();
      if (!comm::agree(comm, results[c].failure.empty())) continue;
      present[c]->reset();
      if (options.on_turn) options.on_turn(results[c].setting);
      action(*present[c], results[c]);
    }
  };
  each(0, [&](Contender& contender, Measurement& result) { (void)turn(comm, contender, result.failure); });
  if (options.memory)
    each(0, [&](Contender& contender, Measurement& result) {
      result.bytes_per_particle = peak_growth(comm, problem, contender, result.failure);
    });
  for (int repeat = 0; repeat < options.repeats; ++repeat)
    each(static_cast<std::size_t>(repeat), [&](Contender& contender, Measurement& result) {
      const auto seconds = turn(comm, contender, result.failure);
      if (!seconds) return;
      result.seconds.push_back(*seconds);
      judge(comm, problem, contender, result);
    });
  for (Contender* contender : present) contender->reset();
  return results;
}

}  // namespace rcb::bench
