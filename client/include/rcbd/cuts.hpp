// rcbd/cuts.hpp, a part of rcbd/rcbd.hpp: handles, arrays that hold them, and what cuts answer.
#ifndef RCBD_CUTS_HPP
#define RCBD_CUTS_HPP

#include <memory>
#include <utility>

#include <rcbd/positions.hpp>

namespace rcbd {

// Holds a handle of rcbd.h. Copies count here, not by rcbd_retain(), which costs a call.
template <typename T>
class Handle {
 public:
  Handle() noexcept = default;
  // Takes over a holder that rcbd.h gave.
  explicit Handle(T* holder) {
    if (holder != nullptr) handle_.reset(holder, rcbd_release);
  }
  explicit operator bool() const noexcept { return handle_ != nullptr; }
  // For the functions of rcbd.h; it stays this handle's.
  T* get() const noexcept { return handle_.get(); }

 protected:
  const std::shared_ptr<T>& shared() const noexcept { return handle_; }

 private:
  std::shared_ptr<T> handle_;
};

namespace detail {

template <typename Number, typename Result>
using IfNumber = std::enable_if_t<std::is_arithmetic<Number>::value, Result>;

// What keeps arrays and texts valid. Moved, it is copied: so what it was moved from stays valid, too.
class Holder {
 public:
  Holder() = default;
  explicit Holder(std::shared_ptr<const void> handle) : handle_(std::move(handle)) {}
  Holder(const Holder&) = default;
  Holder& operator=(const Holder&) = default;

 private:
  std::shared_ptr<const void> handle_;
};

}  // namespace detail

// An array that belongs to a handle, which it holds.
template <typename T>
class Array {
 public:
  Array() = default;
  Array(const T* data, std::size_t size, std::shared_ptr<const void> handle)
      : data_(data), size_(size), holder_(std::move(handle)) {}
  const T* data() const { return data_; }
  std::size_t size() const { return size_; }
  bool empty() const { return size_ == 0; }
  const T* begin() const { return data_; }
  const T* end() const { return data_ + size_; }
  const T& operator[](std::size_t k) const { return data_[k]; }

 private:
  const T* data_ = nullptr;
  std::size_t size_ = 0;
  detail::Holder holder_;
};

enum class Norm : std::int32_t { max = RCBD_MAX, euclid = RCBD_EUCLID };

// A distance from regions, across the borders of a periodic box too.
struct Near {
  double width = 0;
  Box periodic = {};
  Norm norm = Norm::max;
};

// rcbd_ask_options. Each array has a value for each position.
struct AskOptions {
  View<std::int64_t> ids = {};
  View<std::int32_t> last_part = {};
  View<double> widths = {};
  std::int64_t entries_max = 268435456;
  int seats = 0;
  int threads = 1;
};

// Lists of rows or parts, one after another.
class Lists : public Handle<rcbd_lists> {
 public:
  Lists() = default;
  // dims: of the cuts that were asked.
  Lists(rcbd_lists* holder, int dims) : Handle(holder), dims_(dims) {}
  std::size_t size() const { return static_cast<std::size_t>(view().lists); }
  // Of all lists together.
  std::size_t entries() const { return static_cast<std::size_t>(view().entries); }
  // List k: the rows of a halo; the parts of neighbours and boxes.
  Array<std::int64_t> items(std::size_t k = 0) const {
    const rcbd_lists_view all = view();
    return {all.item + begin_of(all, k), begin_of(all, k + 1) - begin_of(all, k), shared()};
  }
  Array<std::int64_t> operator[](std::size_t k) const { return items(k); }
  // [entries of list k][dims], by how many periods each is to be moved; empty where no axis is periodic.
  Array<std::int32_t> shifts(std::size_t k = 0) const {
    const rcbd_lists_view all = view();
    const std::size_t first = begin_of(all, k), last = begin_of(all, k + 1), dims = static_cast<std::size_t>(dims_);
    if (all.shift == nullptr) return {};
    return {all.shift + first * dims, (last - first) * dims, shared()};
  }
  int dims() const { return dims_; }
  // All of them, valid as long as this handle holds them.
  rcbd_lists_view view() const {
    rcbd_lists_view view = RCBD_LISTS_VIEW;
    check(rcbd_lists_read(get(), &view));
    return view;
  }

 private:
  static std::size_t begin_of(const rcbd_lists_view& all, std::size_t k) {
    if (k > static_cast<std::size_t>(all.lists))
      throw Error(RCBD_NOT_FOUND, "there are " + std::to_string(all.lists) + " lists, from 0 on",
                  "ask for one of these");
    return static_cast<std::size_t>(all.offset[k]);
  }

  int dims_ = 0;
};

// part is -1 where no region has two opposite faces.
struct Narrowest {
  int part = -1;
  int axis = -1;
  double width = 0;
};

namespace detail {

// For rcbd.h; they refer to the arrays and the box that are given.
inline rcbd_near near_of(const Near& near) {
  rcbd_near to = RCBD_NEAR;
  to.width = near.width;
  to.lo = near.periodic.lo.data();
  to.hi = near.periodic.hi.data();
  to.norm = static_cast<std::int32_t>(near.norm);
  return to;
}
inline rcbd_ask_options ask_of(const Positions& positions, const AskOptions& options) {
  const std::int64_t count = positions.get()->count;
  rcbd_ask_options to = RCBD_ASK_OPTIONS;
  to.ids = column(options.ids, count, "ids");
  to.last_part = column(options.last_part, count, "last parts");
  to.widths = column(options.widths, count, "widths");
  to.entries_max = options.entries_max;
  to.seats = options.seats;
  to.threads = options.threads;
  return to;
}

}  // namespace detail

// The cuts after a step: a value that does not change, and asks the service nothing.
class Cuts : public Handle<rcbd_cuts> {
 public:
  using Handle::Handle;
  std::int64_t epoch() const { return describe().epoch; }
  std::uint64_t hash() const { return describe().hash; }
  int parts() const { return describe().parts; }
  int dims() const { return describe().dims; }
  // Of each part; infinite where it has no bound.
  std::vector<Box> regions() const {
    const rcbd_cuts_info info = describe();
    const auto dims = static_cast<std::size_t>(info.dims);
    std::vector<Box> boxes(static_cast<std::size_t>(info.parts));
    std::vector<double> lo(boxes.size() * dims), hi(boxes.size() * dims);
    check(rcbd_cuts_regions(get(), lo.data(), hi.data()));
    for (std::size_t k = 0; k < lo.size(); ++k) {
      boxes[k / dims].lo[k % dims] = lo[k];
      boxes[k / dims].hi[k % dims] = hi[k];
    }
    return boxes;
  }
  // The part that owns each position.
  std::vector<std::int32_t> owner(const Positions& positions, const AskOptions& options = {}) const {
    std::vector<std::int32_t> part(get() == nullptr ? 0 : positions.count());
    owner(positions, part.data(), options);
    return part;
  }
  // The same, into an array [count].
  void owner(const Positions& positions, std::int32_t* part, const AskOptions& options = {}) const {
    const rcbd_ask_options ask = detail::ask_of(positions, options);
    check(rcbd_cuts_owner(get(), positions.get(), &ask, part));
  }
  // A list for each part (or seat): the rows that it needs of these.
  Lists halo(const Positions& positions, const Near& near, const AskOptions& options = {}) const {
    const rcbd_ask_options ask = detail::ask_of(positions, options);
    const rcbd_near distance = detail::near_of(near);
    return ask_lists([&](rcbd_lists** to) { return rcbd_cuts_halo(get(), positions.get(), &distance, &ask, to); });
  }
  template <typename Number>  // so that {0.1} is a Near still
  detail::IfNumber<Number, Lists> halo(const Positions& positions, Number width, const AskOptions& options = {}) const {
    return halo(positions, Near{static_cast<double>(width)}, options);
  }
  // One list: the parts within the width.
  Lists neighbours(int part, const Near& near) const {
    const rcbd_near distance = detail::near_of(near);
    return ask_lists([&](rcbd_lists** to) { return rcbd_cuts_neighbours(get(), part, &distance, to); });
  }
  template <typename Number>
  detail::IfNumber<Number, Lists> neighbours(int part, Number width) const {
    return neighbours(part, Near{static_cast<double>(width)});
  }
  // One list: the parts that touch [lo, hi].
  Lists box(const Point& lo, const Point& hi, const Box& periodic = {}) const {
    const Near near{0, periodic};
    const rcbd_near distance = detail::near_of(near);
    return ask_lists([&](rcbd_lists** to) { return rcbd_cuts_box(get(), lo.data(), hi.data(), &distance, to); });
  }
  Narrowest narrowest(const Box& periodic = {}) const {
    const Near near{0, periodic};
    const rcbd_near distance = detail::near_of(near);
    std::int32_t part = -1, axis = -1;
    double width = 0;
    check(rcbd_cuts_narrowest(get(), &distance, &part, &axis, &width));
    return {part, axis, width};
  }
  rcbd_cuts_info describe() const {
    rcbd_cuts_info info = RCBD_CUTS_INFO;
    check(rcbd_cuts_describe(get(), &info));
    return info;
  }

 private:
  template <typename Ask>
  Lists ask_lists(const Ask& ask) const {
    const int dims_of_shifts = dims();
    rcbd_lists* lists = nullptr;
    check(ask(&lists));
    return Lists(lists, dims_of_shifts);
  }
};

}  // namespace rcbd

#endif
