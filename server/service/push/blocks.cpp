#include "server/service/push/blocks.hpp"

#include <algorithm>
#include <array>
#include <cstring>
#include <numeric>
#include <string>
#include <utility>

#include <fmt/format.h>

#include "common/layout/layout.hpp"
#include "server/service/context/collective.hpp"
#include "server/service/push/shared_source.hpp"

namespace rcb::service {
namespace {

// Which rows of a block each rank is dealt: evenly, to the ranks that own parts of the block's seat.
class Deal {
 public:
  Deal(const Block& block, int seats, int ranks) : n_(block.n) {
    first_ = block.seat * ranks / seats;
    last_ = std::max((block.seat + 1) * ranks / seats, first_ + 1);
  }
  std::uint64_t begin(int rank) const {
    return layout::row_begin(std::clamp(rank, first_, last_) - first_, n_, last_ - first_);
  }
  std::uint64_t count(int rank) const { return begin(rank + 1) - begin(rank); }

 private:
  std::uint64_t n_;
  int first_ = 0;  // rank
  int last_ = 1;
};

class Reader {
 public:
  Reader(Context& context, Scene& scene, const PushRequest& push)
      : context_(context), comm_(context.comm), scene_(scene), push_(push) {
    set().dims = scene.options.dims;
    set().has_weights = push.weights;
  }

  Result<Arrived> read() {
    Status ready = find_slices();
    if (ready.ok()) ready = make_room();
    if (Status status = agree_status(comm_, ready); !status.ok()) return status;
    for (const Block& block : push_.blocks) {
      const std::uint64_t begin = at_;
      if (block.way == api::Way::endpoint)
        deal(block);
      else if (PushSlice* slice = slice_of(block))
        ready = take(*slice, std::move(ready));
      if (at_ > begin) arrived_.runs.push_back({block.seat, begin, at_ - begin});
    }
    if (Status status = agree_status(comm_, ready); !status.ok()) return status;
    context_.slices.clear();
    return std::move(arrived_);
  }

 private:
  particles::ParticleSet& set() { return arrived_.set; }
  std::size_t dims() { return static_cast<std::size_t>(set().dims); }
  bool counted_by_memory(const PushSlice& slice) const {
    return !slice.shared.empty() && slice.shared.back().where.name == "row";
  }

  // What has come to this rank of a seat's block; of one by the endpoint, to rank 0. Null: nothing.
  PushSlice* slice_of(const Block& block) {
    const auto found = std::ranges::lower_bound(context_.slices, block.seat, {}, &PushSlice::seat);
    return found == context_.slices.end() || found->seat != block.seat ? nullptr : &*found;
  }

  // How many rows a slice that is read here brings.
  std::uint64_t count_of(const PushSlice& slice) const {
    if (slice.shared.empty() || counted_by_memory(slice)) return slice.count;
    return layout::row_begin(comm_.rank() + 1, slice.rows, comm_.size()) -
           layout::row_begin(comm_.rank(), slice.rows, comm_.size());
  }

  // Adds up what comes, and compares it with the order.
  Status find_slices() {
    std::ranges::stable_sort(context_.slices, {}, &PushSlice::seat);
    for (const Block& block : push_.blocks) {
      const PushSlice* const slice = slice_of(block);
      if (Status status = check_rows(block, slice); !status.ok()) return status;
      if (block.way == api::Way::endpoint)
        count_ += Deal(block, push_.seats, comm_.size()).count(comm_.rank());
      else if (slice != nullptr)
        count_ += count_of(*slice);
    }
    return {};
  }

  // Whether the rows that the order says have come here: by the endpoint all of them, to rank 0; in memory without a
  // list all of them, of which each rank takes its share; else those counted for this rank.
  Status check_rows(const Block& block, const PushSlice* slice) {
    const std::uint64_t wanted = block.way == api::Way::endpoint && !context_.root() ? 0
                                 : block.counts.empty()                              ? block.n
                                                        : block.counts[static_cast<std::size_t>(comm_.rank())];
    const bool counted = slice != nullptr && (slice->shared.empty() || !block.counts.empty());
    const std::uint64_t come = slice == nullptr ? 0 : counted ? slice->count : slice->rows;
    const std::size_t arrays = dims() + (push_.weights ? 1U : 0U) + (push_.ids ? 1U : 0U);
    const auto whole = [come](const wire::Array& array) { return array.bytes.size() == 8 * come; };
    const bool fits = slice == nullptr || !slice->shared.empty() ||
                      (slice->arrays.size() == arrays && std::ranges::all_of(slice->arrays, whole));
    if (come == wanted && fits) return {};
    return {Code::aborted,
            fmt::format("{} rows of the block of seat {} have come to rank {}, not {} whole ones", come, block.seat,
                        comm_.rank(), wanted),
            "push the step again"};
  }

  // Whether all rows here are those of one slice that this rank has received: its memory is used as it is.
  bool takes_slice() const {
    if (context_.slices.size() != 1) return false;
    const PushSlice& only = context_.slices.front();
    const auto dealt = [&only](const Block& block) {
      return block.seat == only.seat && block.way == api::Way::endpoint;
    };
    return only.shared.empty() && only.count == count_ && std::ranges::none_of(push_.blocks, dealt);
  }

  Status make_room() {
    const Status full(Code::too_large, fmt::format("rank {} has no memory for {} particles", comm_.rank(), count_));
    if (takes_slice()) return push_.ids || set().id.try_reserve(count_) ? Status() : full;
    bool fits = true;
    const auto reserve = [&](auto& array) {
      using T = std::remove_reference_t<decltype(array[0])>;
      array = context_.options.spare->take(scene_.name).release_as<T>();
      fits = fits && array.try_reserve(count_);
    };
    for (std::size_t a = 0; a < dims(); ++a) reserve(set().position[a]);
    if (push_.weights) reserve(set().weight);
    reserve(set().id);
    if (!fits) return full;
    set().resize(count_);
    return {};
  }

  // Calls visit(index of the slice's array, where it goes) for each array that rows bring.
  template <typename Visit>
  void for_each_array(const Visit& visit) {
    std::size_t array = 0;
    for (std::size_t a = 0; a < dims(); ++a) visit(array++, set().position[a]);
    if (push_.weights) visit(array++, set().weight);
    if (push_.ids) visit(array, set().id);
  }

  void number_rows(std::uint64_t first_row, std::uint64_t count) {
    if (push_.ids) return;
    std::iota(set().id.begin() + at_, set().id.begin() + at_ + count, static_cast<particles::Id>(first_row));
  }

  // Collective.
  void deal(const Block& block) {
    const Deal deal(block, push_.seats, comm_.size());
    const std::uint64_t mine = deal.count(comm_.rank());
    PushSlice* const whole = slice_of(block);
    for_each_array([&](std::size_t array, auto& to) {
      std::vector<std::span<const std::byte>> send(static_cast<std::size_t>(comm_.size()));
      std::vector<std::span<std::byte>> receive(send.size());
      for (int r = 0; whole != nullptr && r < comm_.size(); ++r)
        send[static_cast<std::size_t>(r)] =
            whole->arrays[array].bytes.span().subspan(8 * deal.begin(r), 8 * deal.count(r));
      receive[0] = std::as_writable_bytes(to.span().subspan(at_, mine));
      comm_.exchange(send, receive);
      if (whole != nullptr) whole->arrays[array].bytes.release();  // it is free for the next array
    });
    number_rows(deal.begin(comm_.rank()), mine);
    at_ += mine;
  }

  // Local. Reads nothing more if `before` is an error, since what failed there may be wrong here.
  Status take(PushSlice& slice, Status before) {
    const std::uint64_t count = count_of(slice);
    if (before.ok() && !slice.shared.empty()) {
      before = read_shared(slice, count);
    } else if (before.ok() && takes_slice()) {
      arrived_.took_slice = true;
      for_each_array([&](std::size_t array, auto& to) {
        using T = std::remove_reference_t<decltype(to[0])>;
        to = slice.arrays[array].bytes.template release_as<T>();
      });
      if (!push_.ids) set().id.resize(count);
      number_rows(slice.first_row, count);
    } else if (before.ok()) {
      std::vector<Buffer<std::byte>> read;
      for_each_array([&](std::size_t array, auto& to) {
        Buffer<std::byte>& from = slice.arrays[array].bytes;
        if (count > 0) std::memcpy(to.data() + at_, from.data(), from.size());
        read.push_back(std::move(from));
      });
      number_rows(slice.first_row, count);
      context_.options.spare->keep(scene_.name, std::move(read));
    }
    at_ += count;
    return before;
  }

  Status read_shared(const PushSlice& slice, std::uint64_t count) {
    auto source = SharedSource::open(slice, set().dims);
    if (!source.ok()) return source.status();
    const std::uint64_t first = layout::row_begin(comm_.rank(), slice.rows, comm_.size());
    // Some rows at a time: the axes of a row often lie together, and stay in the cache until all are read.
    std::array<particles::Id, 1024> numbers;
    for (std::uint64_t done = 0; done < count; done += numbers.size()) {
      const std::span rows = std::span(numbers).first(std::min<std::uint64_t>(numbers.size(), count - done));
      const std::uint64_t to = at_ + done;
      if (!counted_by_memory(slice))
        std::iota(rows.begin(), rows.end(), static_cast<particles::Id>(first + done));
      else if (Status listed = source->rows(done, rows); !listed.ok())
        return listed;
      for (std::size_t a = 0; a < dims(); ++a) source->positions(a, rows, set().position[a].data() + to);
      if (push_.weights) source->weights(rows, set().weight.data() + to);
      if (push_.ids)
        source->ids(rows, set().id.data() + to);
      else
        std::ranges::copy(rows, set().id.data() + to);
    }
    return {};
  }

  Context& context_;
  comm::Comm& comm_;
  Scene& scene_;
  const PushRequest& push_;
  Arrived arrived_;
  std::uint64_t count_ = 0;  // of this rank's rows
  std::uint64_t at_ = 0;     // those read so far
};

}  // namespace

Result<Arrived> read_blocks(Context& context, Scene& scene, const PushRequest& push) {
  return Reader(context, scene, push).read();
}

}  // namespace rcb::service
