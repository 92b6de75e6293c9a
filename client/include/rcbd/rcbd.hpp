// rcbd/rcbd.hpp: the C++ interface to rcbd, a service that divides the particles of a simulation into balanced parts.
// For C++14 and later; needs rcbd.h, the standard library and exceptions. Link with -lrcbd (librcbd.so.1).
//
//   std::vector<double> xyz = initial_positions();                // x, y, z of the first particle, of the second, ...
//   rcbd::Client client = rcbd::connect();
//   rcbd::SceneOptions options;                                   // C++20: client.scene_open("jet", {.parts = 8})
//   options.parts = 8;
//   rcbd::Scene scene = client.scene_open("jet", options);
//   for (int k = 0; k < 100; ++k) {
//     rcbd::Step step = scene.step(xyz);
//     if (step.report().repartitioned) std::printf("step %d: %s\n", k, step.report().reason);
//     advance(xyz);                                               // the solver's own work
//   }
//   rcbd::Cuts cuts = scene.cuts();
//   rcbd::Lists halo = cuts.halo(xyz, rcbd::Near{0.1});           // what the others need of these particles
//   for (std::int64_t row : halo.items(3)) std::printf("part 3 needs particle %d\n", int(row));
//
// rcbd.h is the reference: X::y here is rcbd_x_y there (Step is its rcbd_result), with the same meaning, units,
// defaults, deadlines and rules for threads and forks. What is told here is what differs.
//
// Failures are exceptions, rcbd::Error, with code, message and hint.
//
// Handles (Client, Scene, Arrays, Op, Step, Cuts, Lists) are like std::shared_ptr: one that is made without arguments,
// or was moved from, holds nothing, and all calls with it fail; a copy is one more holder. What a Step, Cuts or Lists
// tells is an Array or a Report, which holds its handle: it stays valid after later steps, after close() and when the
// handle itself is gone.
//
// The solver's arrays are not copied: Positions and View refer to them, and are valid as long as they are. A vector
// that would be gone at the end of the line is refused by the compiler: give it a name.
#ifndef RCBD_RCBD_HPP
#define RCBD_RCBD_HPP

#if !defined(__cpp_exceptions) && !defined(__EXCEPTIONS)
#error "rcbd/rcbd.hpp reports failures by exceptions; without them call the functions of rcbd/rcbd.h"
#endif

#include <array>
#include <cstddef>
#include <cstdint>
#include <initializer_list>
#include <limits>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include <rcbd/rcbd.h>

namespace rcbd {

// what() is the message. The code is an rcbd_code, or one of a later version.
class Error : public std::runtime_error {
 public:
  Error(int code, const std::string& message, const std::string& hint = "")
      : std::runtime_error(message), code_(code), hint_(hint) {}
  int code() const noexcept { return code_; }
  const char* code_name() const noexcept { return rcbd_code_name(code_); }
  std::string message() const { return what(); }
  const std::string& hint() const noexcept { return hint_; }

 private:
  int code_;
  std::string hint_;
};

// Throws what a function of rcbd.h has told.
inline void check(int code) {
  if (code != RCBD_OK) throw Error(code, rcbd_message(), rcbd_hint());
}

// ---- arrays of the solver ----

// Values of the solver: of a vector, a std::array, a std::span, whatever has data() and size(), or a pointer and a
// number.
template <typename T>
class View {
 public:
  View() = default;
  View(const T* data, std::size_t size) : data_(data), size_(size), given_(true) {}
  template <typename Range, typename = std::enable_if_t<
                                std::is_convertible<decltype(std::declval<const Range&>().data()), const T*>::value>>
  View(const Range& values) : View(values.data(), values.size()) {}
  template <typename U, typename A>
  View(std::vector<U, A>&&) = delete;

  const T* data() const { return data_; }
  std::size_t size() const { return size_; }
  // Whether there are any, or a solver that has no particles gave its empty array.
  bool given() const { return given_; }

 private:
  const T* data_ = nullptr;
  std::size_t size_ = 0;
  bool given_ = false;
};

namespace detail {

// What a row of positions may be: a number, or an array of one to three.
template <typename T>
struct Row {};
template <>
struct Row<double> {
  using Number = double;
};
template <>
struct Row<float> {
  using Number = float;
};
template <typename T, std::size_t D>
struct Row<std::array<T, D>> : Row<T> {};
template <typename T, std::size_t D>
struct Row<T[D]> : Row<T> {};

template <typename T>
using NumberOf = typename Row<std::remove_cv_t<T>>::Number;
template <typename Range>
using ElementOf = std::remove_pointer_t<decltype(std::declval<Range&>().data())>;
template <typename T>
using Writable = std::enable_if_t<!std::is_const<std::remove_all_extents_t<T>>::value>;

// How many numbers a row has.
template <typename T>
int dims_of(int given) {
  return std::is_arithmetic<T>::value ? given : static_cast<int>(sizeof(T) / sizeof(NumberOf<T>));
}

template <typename T>
std::size_t rows_of(std::size_t size, int dims) {
  if (!std::is_arithmetic<T>::value) return size;
  if (dims < 1 || size % static_cast<std::size_t>(dims) != 0)
    throw Error(RCBD_INVALID_ARGUMENT,
                std::to_string(size) + " numbers are no positions in " + std::to_string(dims) + " dimensions",
                "give the number of dimensions after the array, if it is not 3");
  return size / static_cast<std::size_t>(dims);
}

// An array with a value for each row, or null.
template <typename T>
const T* column(const View<T>& values, std::int64_t count, const char* what) {
  if (values.given() && values.size() != static_cast<std::size_t>(count))
    throw Error(RCBD_INVALID_ARGUMENT,
                std::to_string(values.size()) + " " + what + " for " + std::to_string(count) + " positions",
                "give one for each position, or none");
  return values.data();
}

}  // namespace detail

// Positions in arrays of the solver, of double or float: rcbd_positions.
class Positions {
 public:
  Positions() = default;
  // [count][dims]: a vector of numbers, or of std::array<double, 3>, whose dims it takes.
  template <typename Range, typename T = detail::ElementOf<const Range>, typename = detail::NumberOf<T>>
  Positions(const Range& xyz, int dims = 3) : Positions(xyz.data(), detail::rows_of<T>(xyz.size(), dims), dims) {}
  template <typename T, typename A>
  Positions(std::vector<T, A>&&, int dims = 3) = delete;
  // Pointer and number of rows: also of double xyz[count][3].
  template <typename T, typename Number = detail::NumberOf<T>>
  Positions(const T* xyz, std::size_t count, int dims = 3) {
    const auto* const first = reinterpret_cast<const Number*>(xyz);
    dims = detail::dims_of<T>(dims);
    for (int a = 0; a < 3 && a < dims; ++a) set_axis(a, first == nullptr ? nullptr : first + a);
    set_shape<Number>(count, static_cast<std::size_t>(dims > 0 ? dims : 1), dims);
  }
  // An array for each axis: axes(x, y, z).
  template <typename First, typename... More, typename T = detail::ElementOf<const First>>
  static Positions axes(const First& x, const More&... more) {
    for (const std::size_t size : {x.size(), more.size()...})
      if (size != x.size())
        throw Error(RCBD_INVALID_ARGUMENT,
                    std::to_string(x.size()) + " values on one axis, " + std::to_string(size) + " on another");
    return axes<std::remove_cv_t<T>>({x.data(), more.data()...}, x.size());
  }
  // The same of pointers, with `stride` elements from one row to the next: axes({&p[0].x, &p[0].y}, n, sizeof p[0] /
  // 8).
  template <typename T, typename = detail::NumberOf<T>>
  static Positions axes(std::initializer_list<const T*> first, std::size_t count, std::size_t stride = 1) {
    Positions positions;
    int a = 0;
    for (const T* axis : first) positions.set_axis(a++, axis);
    positions.set_shape<T>(count, stride, a);
    return positions;
  }

  std::size_t count() const { return static_cast<std::size_t>(raw_.count); }
  int dims() const { return raw_.dims; }
  const rcbd_positions* get() const { return &raw_; }

 protected:
  explicit Positions(const rcbd_positions& raw) : raw_(raw) {}

 private:
  void set_axis(int a, const void* first) {
    if (a < 3) raw_.axis[a] = const_cast<void*>(first);
  }
  template <typename Number>
  void set_shape(std::size_t count, std::size_t stride, int dims) {
    raw_.count = static_cast<std::int64_t>(count);
    raw_.stride = static_cast<std::int64_t>(stride);
    raw_.dims = dims;
    raw_.single = std::is_same<Number, float>::value;
  }

  rcbd_positions raw_ = RCBD_POSITIONS;
};

// Those that wrap() may move.
class WritablePositions : public Positions {
 public:
  explicit WritablePositions(const rcbd_positions& raw) : Positions(raw) {}
  template <typename Range, typename T = detail::ElementOf<Range>, typename = detail::NumberOf<T>,
            typename = detail::Writable<T>>
  WritablePositions(Range& xyz, int dims = 3) : Positions(xyz, dims) {}
  template <typename T, typename = detail::NumberOf<T>, typename = detail::Writable<T>>
  WritablePositions(T* xyz, std::size_t count, int dims = 3) : Positions(xyz, count, dims) {}
  template <typename First, typename... More, typename T = detail::ElementOf<First>>
  static WritablePositions axes(First& x, More&... more) {
    return axes<T>({x.data(), more.data()...}, Positions::axes(x, more...).count());
  }
  template <typename T, typename = detail::NumberOf<T>, typename = detail::Writable<T>>
  static WritablePositions axes(std::initializer_list<T*> first, std::size_t count, std::size_t stride = 1) {
    const T* axis[3] = {};
    int dims = 0;
    for (T* one : first) {
      if (dims < 3) axis[dims] = one;
      ++dims;
    }
    rcbd_positions raw = *Positions::axes({axis[0], axis[1], axis[2]}, count, stride).get();
    raw.dims = dims;
    return WritablePositions(raw);
  }
};

// A place, or a length an axis; those of unused axes are not read.
using Point = std::array<double, 3>;

// As long as it is infinite along an axis, nothing is periodic there.
struct Box {
  Point lo{{-std::numeric_limits<double>::infinity(), -std::numeric_limits<double>::infinity(),
            -std::numeric_limits<double>::infinity()}};
  Point hi{{std::numeric_limits<double>::infinity(), std::numeric_limits<double>::infinity(),
            std::numeric_limits<double>::infinity()}};
};

// Moves positions outside of [lo, hi) into it, by whole periods: rcbd_wrap().
inline void wrap(const WritablePositions& positions, const Point& lo, const Point& hi) {
  check(rcbd_wrap(positions.get(), lo.data(), hi.data()));
}

// ---- handles and what they tell ----

// A holder of a handle of rcbd.h.
template <typename T>
class Handle {
 public:
  Handle() noexcept = default;
  // Takes over a holder that rcbd.h gave.
  explicit Handle(T* holder) noexcept : handle_(holder) {}
  Handle(const Handle& other) noexcept : handle_(other.handle_) { retain(handle_); }
  Handle(Handle&& other) noexcept : handle_(other.handle_) { other.handle_ = nullptr; }
  Handle& operator=(Handle other) noexcept {
    std::swap(handle_, other.handle_);
    return *this;
  }
  ~Handle() { rcbd_release(handle_); }

  explicit operator bool() const noexcept { return handle_ != nullptr; }
  // For the functions of rcbd.h; it stays this handle's.
  T* get() const noexcept { return handle_; }

 private:
  static void retain(void* handle) noexcept {
    if (handle != nullptr) rcbd_retain(handle);
  }

  T* handle_ = nullptr;
};

namespace detail {

// What keeps arrays and texts valid. Moved, it is copied: so what it was moved from stays valid, too.
class Holder : private Handle<void> {
 public:
  Holder() = default;
  explicit Holder(void* handle) : Handle<void>(rcbd_retain(handle)) {}
  Holder(const Holder&) = default;
  Holder& operator=(const Holder&) = default;
};

}  // namespace detail

// An array that belongs to a handle, which it holds.
template <typename T>
class Array {
 public:
  Array() = default;
  Array(const T* data, std::size_t size, void* handle) : data_(data), size_(size), holder_(handle) {}
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

// Its texts are valid as long as it, or its Step, is there.
struct Report : rcbd_report {
  Report() : rcbd_report RCBD_REPORT {}
  detail::Holder holder;
};

// Rows whose part differs from what was told last, and their parts.
struct Changed {
  Array<std::int64_t> rows;
  Array<std::int32_t> parts;
};

// Rows that belong to other seats, and these.
struct Leaving {
  Array<std::int64_t> rows;
  Array<std::int32_t> seats;
};

// The result of a step: rcbd_result.
class Step : public Handle<rcbd_result> {
 public:
  using Handle::Handle;
  Report report() const {
    Report report;
    check(rcbd_result_report(get(), &report));
    report.holder = detail::Holder(get());
    return report;
  }
  // By row. Needs want_parts.
  Array<std::int32_t> parts() const {
    const std::int32_t* part = nullptr;
    std::int64_t count = 0;
    check(rcbd_result_parts(get(), &part, &count));
    return {part, static_cast<std::size_t>(count), get()};
  }
  // Needs want_changed.
  Changed changed() const { return pairs<Changed>(rcbd_result_changed); }
  Leaving leaving() const { return pairs<Leaving>(rcbd_result_leaving); }

 private:
  template <typename Pairs, typename Function>
  Pairs pairs(Function read) const {
    const std::int64_t* row = nullptr;
    const std::int32_t* number = nullptr;
    std::int64_t count = 0;
    check(read(get(), &row, &number, &count));
    const auto size = static_cast<std::size_t>(count);
    return {{row, size, get()}, {number, size, get()}};
  }
};

// A step that is being made. The solver's arrays must stay as they are until it is done.
class Op : public Handle<rcbd_op> {
 public:
  using Handle::Handle;
  // Waits at most so long; < 0: until it is done. Holds nothing where it isn't: while (!(step = op.wait(0.1))) ...
  // Throws what the step failed with.
  Step wait(double seconds = -1) const {
    rcbd_result* result = nullptr;
    const int code = rcbd_wait(get(), seconds, &result);
    if (code != RCBD_PENDING) check(code);
    return Step(result);
  }
  void cancel() const noexcept { rcbd_cancel(get()); }
};

// ---- cuts ----

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
    return {all.item + begin_of(all, k), begin_of(all, k + 1) - begin_of(all, k), get()};
  }
  // [entries of list k][dims], by how many periods each is to be moved; empty where there are none.
  Array<std::int32_t> shifts(std::size_t k = 0) const {
    const rcbd_lists_view all = view();
    const std::size_t first = begin_of(all, k), last = begin_of(all, k + 1), dims = static_cast<std::size_t>(dims_);
    if (all.shift == nullptr) return {};
    return {all.shift + first * dims, (last - first) * dims, get()};
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
    const rcbd_ask_options ask = ask_of(positions, options);
    check(rcbd_cuts_owner(get(), positions.get(), &ask, part));
  }
  // A list for each part (or seat): the rows that it needs of these.
  Lists halo(const Positions& positions, const Near& near, const AskOptions& options = {}) const {
    const rcbd_ask_options ask = ask_of(positions, options);
    const rcbd_near distance = near_of(near);
    return ask_lists([&](rcbd_lists** to) { return rcbd_cuts_halo(get(), positions.get(), &distance, &ask, to); });
  }
  // One list: the parts within the width.
  Lists neighbours(int part, const Near& near) const {
    const rcbd_near distance = near_of(near);
    return ask_lists([&](rcbd_lists** to) { return rcbd_cuts_neighbours(get(), part, &distance, to); });
  }
  // One list: the parts that touch [lo, hi].
  Lists box(const Point& lo, const Point& hi, const Box& periodic = {}) const {
    const Near near{0, periodic};
    const rcbd_near distance = near_of(near);
    return ask_lists([&](rcbd_lists** to) { return rcbd_cuts_box(get(), lo.data(), hi.data(), &distance, to); });
  }
  Narrowest narrowest(const Box& periodic = {}) const {
    const Near near{0, periodic};
    const rcbd_near distance = near_of(near);
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
  static rcbd_near near_of(const Near& near) {
    rcbd_near to = RCBD_NEAR;
    to.width = near.width;
    to.lo = near.periodic.lo.data();
    to.hi = near.periodic.hi.data();
    to.norm = static_cast<std::int32_t>(near.norm);
    return to;
  }
  static rcbd_ask_options ask_of(const Positions& positions, const AskOptions& options) {
    const std::int64_t count = positions.get()->count;
    rcbd_ask_options to = RCBD_ASK_OPTIONS;
    to.ids = detail::column(options.ids, count, "ids");
    to.last_part = detail::column(options.last_part, count, "last parts");
    to.widths = detail::column(options.widths, count, "widths");
    to.entries_max = options.entries_max;
    to.seats = options.seats;
    to.threads = options.threads;
    return to;
  }
};

// ---- client and scene ----

// rcbd_step_options. Arrays have a value for each position.
struct StepOptions {
  std::int64_t step = -1;
  View<std::int64_t> ids = {};
  View<double> weights = {};
  std::int64_t inserted = 0;
  std::int64_t removed = 0;
  double step_seconds = -1;
  bool want_parts = false;
  bool want_changed = false;
  bool send = false;
  int threads = 1;
  double deadline_seconds = 60;
};

enum class Layout { rows = RCBD_ROWS, axes = RCBD_AXES };

// Memory for positions that the service may read in place, valid as long as somebody holds it.
template <typename T>
class Arrays : public Handle<rcbd_arrays> {
 public:
  using Handle::Handle;
  // Coordinate a of row i is axis(a)[i * stride()]. Null for an axis that there isn't.
  T* axis(int a = 0) const { return a < 0 || a > 2 ? nullptr : static_cast<T*>(raw().axis[a]); }
  std::size_t count() const { return static_cast<std::size_t>(raw().count); }
  std::size_t stride() const { return static_cast<std::size_t>(raw().stride); }
  // The first `count` rows, or all. Refers to this memory, but doesn't hold it.
  WritablePositions positions(std::size_t count) const {
    rcbd_positions first = raw();
    if (count > static_cast<std::size_t>(first.count))
      throw Error(RCBD_INVALID_ARGUMENT, std::to_string(count) + " positions of " + std::to_string(first.count),
                  "ask the scene for more room");
    first.count = static_cast<std::int64_t>(count);
    return WritablePositions(first);
  }
  WritablePositions positions() const { return WritablePositions(raw()); }
  operator WritablePositions() const { return positions(); }

 private:
  rcbd_positions raw() const {
    rcbd_positions positions = RCBD_POSITIONS;
    check(rcbd_arrays_positions(get(), &positions));
    return positions;
  }
};

class Scene : public Handle<rcbd_scene> {
 public:
  using Handle::Handle;
  Step step(const Positions& positions, const StepOptions& options = {}) const {
    const rcbd_step_options with = with_options(positions, options);
    rcbd_result* result = nullptr;
    check(rcbd_step(get(), positions.get(), &with, &result));
    return Step(result);
  }
  Op step_begin(const Positions& positions, const StepOptions& options = {}) const {
    const rcbd_step_options with = with_options(positions, options);
    rcbd_op* op = nullptr;
    check(rcbd_step_begin(get(), positions.get(), &with, &op));
    return Op(op);
  }
  // The number of the last step; -1: there was none.
  std::int64_t last_step() const {
    std::int64_t step = -1;
    check(rcbd_last_step(get(), &step));
    return step;
  }
  // The cuts after the last step.
  Cuts cuts() const {
    rcbd_cuts* cuts = nullptr;
    check(rcbd_scene_cuts(get(), &cuts));
    return Cuts(cuts);
  }
  // Room for so many positions, in double or float.
  template <typename T = double>
  Arrays<T> arrays(std::size_t count, Layout layout = Layout::rows) const {
    static_assert(std::is_same<T, double>::value || std::is_same<T, float>::value, "positions are double or float");
    rcbd_arrays* arrays = nullptr;
    check(rcbd_arrays_new(get(), static_cast<std::int64_t>(count), static_cast<rcbd_layout>(layout),
                          std::is_same<T, float>::value, &arrays));
    return Arrays<T>(arrays);
  }
  void close() const { check(rcbd_close(get())); }

 private:
  static rcbd_step_options with_options(const Positions& positions, const StepOptions& options) {
    const std::int64_t count = positions.get()->count;
    rcbd_step_options to = RCBD_STEP_OPTIONS;
    to.step = options.step;
    to.ids = detail::column(options.ids, count, "ids");
    to.weights = detail::column(options.weights, count, "weights");
    to.inserted = options.inserted;
    to.removed = options.removed;
    to.step_seconds = options.step_seconds;
    to.want_parts = options.want_parts;
    to.want_changed = options.want_changed;
    to.send = options.send;
    to.threads = options.threads;
    to.deadline_seconds = options.deadline_seconds;
    return to;
  }
};

// rcbd_scene_options; part_sizes is empty for equal shares.
struct SceneOptions {
  int parts = 0;
  int dims = 3;
  std::string method = "rcb";
  std::string policy = "tolerance";
  std::string positions = "every-step";
  std::vector<double> part_sizes = {};
  double tolerance = 0.1;
  double axis_hysteresis = 1.2;
  double cut_tolerance = 0;
  bool replace = false;
  int threads = 1;
  int seat = 0;
  int seats = 1;
  double deadline_seconds = 60;
};

class Client : public Handle<rcbd_client> {
 public:
  using Handle::Handle;
  // Makes the scene, or goes on with the one that is there.
  Scene scene_open(const std::string& name, const SceneOptions& options = {}) const {
    if (!options.part_sizes.empty() && options.part_sizes.size() != static_cast<std::size_t>(options.parts))
      throw Error(RCBD_INVALID_ARGUMENT, std::to_string(options.part_sizes.size()) + " part sizes for " +
                                             std::to_string(options.parts) + " parts");
    rcbd_scene_options to = RCBD_SCENE_OPTIONS;
    to.parts = options.parts;
    to.dims = options.dims;
    to.method = options.method.c_str();
    to.policy = options.policy.c_str();
    to.positions = options.positions.c_str();
    to.part_sizes = options.part_sizes.empty() ? nullptr : options.part_sizes.data();
    to.tolerance = options.tolerance;
    to.axis_hysteresis = options.axis_hysteresis;
    to.cut_tolerance = options.cut_tolerance;
    to.replace = options.replace;
    to.threads = options.threads;
    to.seat = options.seat;
    to.seats = options.seats;
    to.deadline_seconds = options.deadline_seconds;
    rcbd_scene* scene = nullptr;
    check(rcbd_scene_open(get(), name.c_str(), &to, &scene));
    return Scene(scene);
  }
  void scene_drop(const std::string& name) const { check(rcbd_scene_drop(get(), name.c_str())); }
  // What was waited for since it was asked last, the oldest first: rcbd_notice().
  std::vector<std::string> notices() const {
    std::vector<std::string> texts;
    while (const char* text = rcbd_notice(get())) texts.emplace_back(text);
    return texts;
  }
  // Also in a signal handler.
  void interrupt() const noexcept { rcbd_interrupt(get()); }
  void close() const { check(rcbd_close(get())); }
};

// rcbd_connect_options; texts that are empty are those of the environment.
struct ConnectOptions {
  std::string name = "";
  std::string token = "";
  std::string path = "";
  double deadline_seconds = 5;
  bool outlive = true;
};

// endpoint: "unix:PATH", "HOST:PORT" or "file:PATH"; empty: RCBD_ENDPOINT, or the user's own service.
inline Client connect(const std::string& endpoint = "", const ConnectOptions& options = {}) {
  const auto text = [](const std::string& given) { return given.empty() ? nullptr : given.c_str(); };
  rcbd_connect_options to = RCBD_CONNECT_OPTIONS;
  to.name = text(options.name);
  to.token = text(options.token);
  to.path = text(options.path);
  to.deadline_seconds = options.deadline_seconds;
  to.outlive = options.outlive;
  rcbd_client* client = nullptr;
  check(rcbd_connect(text(endpoint), &to, &client));
  return Client(client);
}

}  // namespace rcbd

#endif
