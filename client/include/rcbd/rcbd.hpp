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
// The solver's arrays are not copied: Positions and View refer to them, and are valid as long as they are. What
// would be gone with its values at the end of the line, as a vector or an Array, is refused by the compiler: give it a
// name.
#ifndef RCBD_RCBD_HPP
#define RCBD_RCBD_HPP

#include <rcbd/cuts.hpp>

namespace rcbd {

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
    report.holder = detail::Holder(shared());
    return report;
  }
  // By row. Needs want_parts.
  Array<std::int32_t> parts() const {
    const std::int32_t* part = nullptr;
    std::int64_t count = 0;
    check(rcbd_result_parts(get(), &part, &count));
    return {part, static_cast<std::size_t>(count), shared()};
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
    return {{row, size, shared()}, {number, size, shared()}};
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

// rcbd_step_options. Arrays have a value for each position.
struct StepOptions {
  std::int64_t step = -1;
  View<std::int64_t> ids = {};
  View<double> weights = {};
  std::int64_t inserted = 0;  // where these are not 0, the number of particles is checked, not which ones
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
  // For rcbd_step(); refers to the arrays of these options.
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
