#include "client/solvers/mpi/cores.hpp"

#include <algorithm>
#include <array>
#include <ctime>
#include <limits>
#include <numeric>
#include <string>

#include <fmt/format.h>

namespace rcb::solvers {
namespace {

constexpr int kNodeDoubles = 4;
static_assert(sizeof(Node) == kNodeDoubles * sizeof(double));

NodeBox overlap(const NodeBox& a, const NodeBox& b) {
  NodeBox box;
  for (std::size_t k = 0; k < 3; ++k) {
    box.first[k] = std::max(a.first[k], b.first[k]);
    box.last[k] = std::max(box.first[k], std::min(a.last[k], b.last[k]));
  }
  return box;
}

std::size_t nodes_in(const NodeBox& box) {
  std::size_t count = 1;
  for (std::size_t k = 0; k < 3; ++k) count *= box.last[k] - box.first[k];
  return count;
}

// Calls apply(first node of a row, nodes in it) for each row of the box.
template <typename Apply>
void for_each_row(Mpm& mpm, const NodeBox& box, const Apply& apply) {
  const auto& nodes = mpm.grid_nodes();
  const std::size_t length = box.last[2] - box.first[2];
  for (std::size_t i = box.first[0]; i < box.last[0]; ++i)
    for (std::size_t j = box.first[1]; j < box.last[1]; ++j)
      if (length > 0) apply(&mpm.grid()[(i * nodes[1] + j) * nodes[2] + box.first[2]], length);
}

const Node* add_rows(Mpm& mpm, const NodeBox& box, const Node* from) {
  for_each_row(mpm, box, [&from](Node* to, std::size_t length) {
    for (std::size_t k = 0; k < length; ++k, ++from)
      for (std::size_t a = 0; a < kNodeDoubles; ++a) to[k].value[a] += from->value[a];
  });
  return from;
}

void copy_rows(Mpm& mpm, const NodeBox& box, std::vector<Node>& to) {
  for_each_row(mpm, box, [&to](const Node* from, std::size_t length) { to.insert(to.end(), from, from + length); });
}

// How many nodes of the box have mass here and in `other`, the rows of another process.
std::size_t count_shared(Mpm& mpm, const NodeBox& box, const Node* other) {
  std::size_t count = 0;
  for_each_row(mpm, box, [&](const Node* own, std::size_t length) {
    for (std::size_t k = 0; k < length; ++k, ++other)
      if (own[k].value[3] > 0 && other->value[3] > 0) ++count;
  });
  return count;
}

// Counts and displacements for MPI_Alltoallv.
struct Layout {
  std::vector<int> count, first;
  explicit Layout(const std::vector<std::size_t>& counts) : count(counts.size()), first(counts.size()) {
    std::size_t at = 0;
    for (std::size_t r = 0; r < counts.size(); ++r) {
      RCB_CHECK(at + counts[r] <= static_cast<std::size_t>(std::numeric_limits<int>::max()), "a message for MPI");
      count[r] = static_cast<int>(counts[r]);
      first[r] = static_cast<int>(at);
      at += counts[r];
    }
  }
};

double processor_seconds() {
  timespec now{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}

}  // namespace

MpiCores::MpiCores(MPI_Comm comm) : comm_(comm) {
  MPI_Comm_rank(comm_, &rank_);
  MPI_Comm_size(comm_, &size_);
}

double MpiCores::computing() const { return processor_seconds() - seconds_in_mpi_; }

template <typename Call>
void MpiCores::in_mpi(const Call& call) {
  const double begin = processor_seconds();
  call();
  seconds_in_mpi_ += processor_seconds() - begin;
}

Result<double> MpiCores::signal_speed(const Mpm& mpm, const Result<double>& mine) {
  std::array<double, 3> values{mine ? 0.0 : 1.0, mpm.wave_speed(), mpm.point_speed()};
  in_mpi([&] { MPI_Allreduce(MPI_IN_PLACE, values.data(), 3, MPI_DOUBLE, MPI_MAX, comm_); });
  if (values[0] > 0) return agree(mine.status());
  return values[1] + values[2];
}

void MpiCores::sum_grid(Mpm& mpm) {
  const auto ranks = static_cast<std::size_t>(size_);
  const auto me = static_cast<std::size_t>(rank_);
  std::vector<NodeBox> boxes(ranks);
  boxes[me] = mpm.touched();
  static_assert(sizeof(NodeBox) == 6 * sizeof(std::uint64_t));
  in_mpi([&] { MPI_Allgather(MPI_IN_PLACE, 0, MPI_DATATYPE_NULL, boxes.data(), 6, MPI_UINT64_T, comm_); });
  std::vector<Node> sent;
  std::vector<std::size_t> counts(ranks, 0);
  for (std::size_t r = 0; r < ranks; ++r) {
    if (r == me) continue;
    const NodeBox common = overlap(boxes[me], boxes[r]);
    counts[r] = nodes_in(common) * kNodeDoubles;
    copy_rows(mpm, common, sent);
  }
  const Layout layout(counts);  // the same for sending and receiving
  std::vector<Node> received(sent.size());
  in_mpi([&] {
    MPI_Alltoallv(sent.data(), layout.count.data(), layout.first.data(), MPI_DOUBLE, received.data(),
                  layout.count.data(), layout.first.data(), MPI_DOUBLE, comm_);
  });
  work_.grid_bytes += static_cast<double>(sent.size() * sizeof(Node));
  const Node* next = received.data();
  for (std::size_t r = 0; r < ranks; ++r)
    if (r != me) {
      const NodeBox common = overlap(boxes[me], boxes[r]);
      work_.shared_nodes += static_cast<double>(count_shared(mpm, common, next));
      next += nodes_in(common);
    }
  std::vector<Node> own;
  copy_rows(mpm, boxes[me], own);
  for_each_row(mpm, boxes[me], [](Node* to, std::size_t length) { std::fill(to, to + length, Node{}); });
  next = received.data();
  for (std::size_t r = 0; r < ranks; ++r) {
    if (r == me)
      add_rows(mpm, boxes[me], own.data());
    else
      next = add_rows(mpm, overlap(boxes[me], boxes[r]), next);
  }
}

Status MpiCores::agree(const Status& mine) {
  int first = mine.ok() ? size_ : rank_;
  in_mpi([&] { MPI_Allreduce(MPI_IN_PLACE, &first, 1, MPI_INT, MPI_MIN, comm_); });
  if (first == size_) return {};
  std::array<std::uint64_t, 3> head{static_cast<std::uint64_t>(mine.code()), mine.message().size(), mine.hint().size()};
  MPI_Bcast(head.data(), 3, MPI_UINT64_T, first, comm_);
  std::string text = mine.message() + mine.hint();
  text.resize(head[1] + head[2]);
  MPI_Bcast(text.data(), static_cast<int>(text.size()), MPI_CHAR, first, comm_);
  return {static_cast<Code>(head[0]), text.substr(0, head[1]), text.substr(head[1])};
}

void MpiCores::hand_over(Mpm& mpm, std::span<const client::LeavingRow> leaving) {
  const auto ranks = static_cast<std::size_t>(size_);
  work_.handed_over += static_cast<double>(leaving.size());
  std::vector<std::vector<PointState>> to(ranks);
  std::vector<std::size_t> rows;  // ascending
  for (const client::LeavingRow& one : leaving) {
    rows.push_back(one.row);
    to[static_cast<std::size_t>(one.to)].push_back(mpm.point(one.row));
  }
  std::vector<std::uint64_t> going(ranks), coming(ranks);
  std::vector<PointState> sent;
  for (std::size_t r = 0; r < ranks; ++r) {
    going[r] = to[r].size();
    sent.insert(sent.end(), to[r].begin(), to[r].end());
  }
  in_mpi([&] { MPI_Alltoall(going.data(), 1, MPI_UINT64_T, coming.data(), 1, MPI_UINT64_T, comm_); });
  std::vector<PointState> arrived(std::accumulate(coming.begin(), coming.end(), std::size_t{0}));
  MPI_Datatype point = MPI_DATATYPE_NULL;
  MPI_Type_contiguous(static_cast<int>(sizeof(PointState)), MPI_BYTE, &point);
  MPI_Type_commit(&point);
  const Layout out({going.begin(), going.end()});
  const Layout in({coming.begin(), coming.end()});
  in_mpi([&] {
    MPI_Alltoallv(sent.data(), out.count.data(), out.first.data(), point, arrived.data(), in.count.data(),
                  in.first.data(), point, comm_);
  });
  MPI_Type_free(&point);
  std::sort(arrived.begin(), arrived.end(), [](const PointState& a, const PointState& b) { return a.id < b.id; });
  mpm.exchange(rows, arrived);
}

std::vector<double> MpiCores::gather_positions(const Mpm& mpm, std::uint64_t points) {
  const std::vector<std::uint64_t> counts = gather(mpm.size());
  std::vector<std::size_t> of_ids(counts.begin(), counts.end()), of_places(counts.begin(), counts.end());
  for (std::size_t& count : of_places) count *= 3;
  std::vector<double> mine;
  for (std::size_t p = 0; p < mpm.size(); ++p)
    for (std::size_t a = 0; a < 3; ++a) mine.push_back(mpm.position(a)[p]);
  std::vector<std::int64_t> ids(rank_ == 0 ? points : 0);
  std::vector<double> places(rank_ == 0 ? 3 * points : 0);
  const Layout id_layout(of_ids);
  const Layout layout(of_places);
  MPI_Gatherv(mpm.id().data(), static_cast<int>(mpm.size()), MPI_INT64_T, ids.data(), id_layout.count.data(),
              id_layout.first.data(), MPI_INT64_T, 0, comm_);
  MPI_Gatherv(mine.data(), static_cast<int>(mine.size()), MPI_DOUBLE, places.data(), layout.count.data(),
              layout.first.data(), MPI_DOUBLE, 0, comm_);
  std::vector<double> by_id(places.size());
  for (std::size_t k = 0; k < ids.size(); ++k)
    std::copy_n(&places[3 * k], 3, &by_id[3 * static_cast<std::size_t>(ids[k])]);
  return by_id;
}

Balance MpiCores::sum(const Balance& mine) {
  Balance all;
  static_assert(sizeof(Balance) == 10 * sizeof(double));
  MPI_Allreduce(&mine, &all, 10, MPI_DOUBLE, MPI_SUM, comm_);
  return all;
}

std::vector<Work> MpiCores::reduce(std::vector<Work> mine, MPI_Op op) {
  constexpr std::size_t kWorkDoubles = 6;
  static_assert(sizeof(Work) == kWorkDoubles * sizeof(double));
  const Layout all({kWorkDoubles * mine.size()});
  MPI_Allreduce(MPI_IN_PLACE, mine.data(), all.count[0], MPI_DOUBLE, op, comm_);
  return mine;
}

std::vector<Work> MpiCores::sum(std::vector<Work> mine) { return reduce(std::move(mine), MPI_SUM); }
std::vector<Work> MpiCores::largest(std::vector<Work> mine) { return reduce(std::move(mine), MPI_MAX); }

std::vector<std::uint64_t> MpiCores::gather(std::uint64_t mine) {
  std::vector<std::uint64_t> all(static_cast<std::size_t>(size_));
  MPI_Allgather(&mine, 1, MPI_UINT64_T, all.data(), 1, MPI_UINT64_T, comm_);
  return all;
}

}  // namespace rcb::solvers
