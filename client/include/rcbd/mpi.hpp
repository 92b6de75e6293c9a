// rcbd/mpi.hpp: what the processes of a solver send to each other, over the solver's own MPI, in C++14 and later:
// rcbd/mpi.h with vectors and exceptions.
//
//   rcbd::Client client = rcbd::mpi::connect(comm);
//   rcbd::Scene scene = rcbd::mpi::scene_open(comm, client, "jet", options);      // process k of M is seat k of M
//
//   std::vector<std::int64_t> id;                                                 // the solver's particles
//   std::vector<std::array<double, 3>> x, v, f;
//
//   rcbd::Step step = rcbd::mpi::step(comm, scene, x, step_options);              // when lists are rebuilt
//   rcbd::mpi::Moves(comm, step, id.size()).move(id, x, v);                       // which then have their new rows
//   rcbd::mpi::Halo halo(comm, scene, x, near, ask);
//
//   halo.forward(rcbd::mpi::positions(x), v);                                     // at each time step
//   halo.reverse_add(f);
//
// client/examples/cpp/dem.cpp is a whole solver. What mpi.h says of failures, order and messages is true here, too.
//
// Failures are exceptions, rcbd::Error. Functions and constructors that take a communicator are called by all its
// processes, and throw the same error on all where something fails on one. What else may throw on one process alone is
// called by together(), since nobody may wait for one that has given up. move(), forward() and reverse_add() throw on
// one process alone where they are called wrongly or there is no memory: end with MPI_Abort then.
#ifndef RCBD_MPI_HPP
#define RCBD_MPI_HPP

#include <algorithm>
#include <exception>
#include <memory>

#include <rcbd/mpi.h>
#include <rcbd/rcbd.hpp>

namespace rcbd {
namespace mpi {

// Throws what a function of mpi.h has told.
inline void check(int code) {
  if (code != RCBD_OK) throw Error(code, rcbd_mpi_message(), rcbd_mpi_hint());
}

// Of all processes: calls work(), and returns what it does. Where it throws on one, all throw that one's error.
template <typename Work, std::enable_if_t<!std::is_void<decltype(std::declval<Work&>()())>::value, int> = 0>
auto together(MPI_Comm comm, Work work) -> decltype(work()) {
  decltype(work()) done{};
  Error error(RCBD_OK, "");
  try {
    done = work();
  } catch (const Error& thrown) {
    error = thrown;
  } catch (const std::exception& thrown) {
    error = Error(RCBD_INTERNAL, thrown.what());
  } catch (...) {
    error = Error(RCBD_INTERNAL, "an exception that is no std::exception");
  }
  check(rcbd_mpi_agree(comm, error.code(), error.what(), error.hint().c_str()));
  return done;
}
template <typename Work, std::enable_if_t<std::is_void<decltype(std::declval<Work&>()())>::value, int> = 0>
void together(MPI_Comm comm, Work work) {
  together(comm, [&] { return work(), true; });
}

// Of all processes: rcbd::connect(), each for itself.
inline Client connect(MPI_Comm comm, const std::string& endpoint = "", const ConnectOptions& options = {}) {
  return together(comm, [&] { return rcbd::connect(endpoint, options); });
}

// Of all processes: Client::scene_open() with seat and seats from the communicator, the others after process 0.
inline Scene scene_open(MPI_Comm comm, const Client& client, const std::string& name, SceneOptions options = {}) {
  MPI_Comm_rank(comm, &options.seat);
  MPI_Comm_size(comm, &options.seats);
  Scene scene = together(comm, [&] { return options.seat == 0 ? client.scene_open(name, options) : Scene(); });
  return together(comm, [&] { return options.seat == 0 ? scene : client.scene_open(name, options); });
}

// Of all processes: Scene::step(). Arrays of wrong lengths on one process are refused before any of them steps. Where
// the step itself fails on one, that one closes its scene, so that the others don't wait for its seat: rcbd_mpi_step().
inline Step step(MPI_Comm comm, const Scene& scene, const Positions& positions, const StepOptions& options = {}) {
  const rcbd_step_options with = together(comm, [&] { return Scene::with_options(positions, options); });
  rcbd_result* result = nullptr;
  check(rcbd_mpi_step(comm, scene.get(), positions.get(), &with, &result));
  return Step(result);
}

namespace detail {

template <typename T>
MPI_Datatype type_of() {
  static_assert(std::is_arithmetic<T>::value && !std::is_same<T, long double>::value,
                "arrays are of numbers, or of std::array of these");
  if (std::is_same<T, double>::value) return MPI_DOUBLE;
  if (std::is_same<T, float>::value) return MPI_FLOAT;
  const MPI_Datatype with_sign[] = {MPI_INT8_T, MPI_INT16_T, MPI_INT32_T, MPI_INT64_T};
  const MPI_Datatype without[] = {MPI_UINT8_T, MPI_UINT16_T, MPI_UINT32_T, MPI_UINT64_T};
  const int k = sizeof(T) == 1 ? 0 : sizeof(T) == 2 ? 1 : sizeof(T) == 4 ? 2 : 3;
  return std::is_signed<T>::value ? with_sign[k] : without[k];
}

template <typename T>
struct Element {
  using Number = T;
};
template <typename T, std::size_t N>
struct Element<std::array<T, N>> {
  using Number = T;
};

}  // namespace detail

// A vector of the solver's, with so many elements a row.
template <typename T>
struct Field {
  std::vector<T>* values;
  std::size_t columns;
  bool positions;

  void resize(std::size_t rows) const { values->resize(rows * columns); }
  rcbd_mpi_field raw() const {
    using Number = typename detail::Element<T>::Number;
    return {values->data(), static_cast<std::int64_t>(values->size() / columns), detail::type_of<Number>(),
            static_cast<std::int32_t>(columns * (sizeof(T) / sizeof(Number))), positions};
  }
  // Throws where it has another number of rows than one of these.
  void expect(std::size_t rows, std::size_t or_rows) const {
    if (values->size() != rows * columns && values->size() != or_rows * columns)
      throw Error(RCBD_INVALID_ARGUMENT,
                  "an array of " + std::to_string(values->size()) + " elements, " + std::to_string(columns) +
                      " a row, where there are " + std::to_string(rows) + " rows",
                  "give arrays of all rows; make moves and halos anew after each step");
  }
};

// [rows][n] in one vector of numbers; a vector without this has an element a row.
template <typename T>
Field<T> columns(std::vector<T>& values, int n) {
  if (n < 1) throw Error(RCBD_INVALID_ARGUMENT, std::to_string(n) + " columns");
  return {&values, static_cast<std::size_t>(n), false};
}
// Positions, which the halo moves to where a periodic image is: of std::array, or [rows][dims] of numbers.
template <typename T>
Field<T> positions(std::vector<T>& values, int dims = 3) {
  Field<T> field = columns(values, std::is_arithmetic<T>::value ? dims : 1);
  field.positions = true;
  return field;
}

namespace detail {

template <typename T>
Field<T> field(std::vector<T>& values) {
  return {&values, 1, false};
}
template <typename T>
Field<T> field(const Field<T>& field) {
  return field;
}

using Each = int[];  // calls a function for each argument, in C++14

}  // namespace detail

// Which rows go where after a step, and how many come.
class Moves {
 public:
  // Of all processes. rows: how many this process has.
  Moves(MPI_Comm comm, const Step& step, std::size_t rows) : moves_(nullptr, rcbd_mpi_moves_free) {
    rcbd_mpi_moves* made = nullptr;
    check(rcbd_mpi_moves_new(comm, step.get(), static_cast<std::int64_t>(rows), &made));
    moves_.reset(made);
  }
  // Of this process, after the moves.
  std::size_t rows() const { return static_cast<std::size_t>(moves_->rows); }
  // Vectors, or what columns() makes of them, get their new rows; each once.
  template <typename... Arrays>
  void move(Arrays&&... arrays) const {
    move_fields(detail::field(arrays)...);
  }

 private:
  template <typename... Fields>
  void move_fields(const Fields&... fields) const {
    const auto before = static_cast<std::size_t>(moves_->before);
    (void)detail::Each{(fields.expect(before, before), 0)...};
    (void)detail::Each{(fields.resize(std::max(before, rows())), 0)...};
    const rcbd_mpi_field raw[] = {fields.raw()...};
    check(rcbd_mpi_move(moves_.get(), raw, sizeof...(fields)));
    (void)detail::Each{(fields.resize(rows()), 0)...};
  }

  std::unique_ptr<rcbd_mpi_moves, void (*)(rcbd_mpi_moves*)> moves_;
};

// Which rows the other processes need as ghosts until the next step, and how many come here.
class Halo {
 public:
  // Of all processes, when lists are rebuilt, with the rows of a step whose moves are made.
  Halo(MPI_Comm comm, const Scene& scene, const Positions& positions, const Near& near, const AskOptions& options = {})
      : Halo(comm, together(comm, [&] { return scene.cuts(); }), positions, near, options) {}
  // The same with cuts that are there.
  Halo(MPI_Comm comm, const Cuts& cuts, const Positions& positions, const Near& near, const AskOptions& options = {})
      : halo_(nullptr, rcbd_mpi_halo_free) {
    const rcbd_ask_options ask = together(comm, [&] { return rcbd::detail::ask_of(positions, options); });
    const rcbd_near distance = rcbd::detail::near_of(near);
    rcbd_mpi_halo* made = nullptr;
    check(rcbd_mpi_halo_new(comm, cuts.get(), positions.get(), &distance, &ask, &made));
    halo_.reset(made);
  }
  std::size_t rows() const { return static_cast<std::size_t>(halo_->rows); }
  std::size_t ghosts() const { return static_cast<std::size_t>(halo_->ghosts); }
  // Fills in the ghosts' rows, behind the others; vectors that have only the others are made longer.
  template <typename... Arrays>
  void forward(Arrays&&... arrays) const {
    forward_fields(detail::field(arrays)...);
  }
  // Adds the ghosts' rows to those of their owners: of int32, int64, float or double.
  template <typename Array>
  void reverse_add(Array&& array) const {
    const auto field = detail::field(array);
    field.expect(rows() + ghosts(), rows() + ghosts());
    const rcbd_mpi_field raw = field.raw();
    check(rcbd_mpi_reverse_add(halo_.get(), halo_->rows, &raw));
  }

 private:
  template <typename... Fields>
  void forward_fields(const Fields&... fields) const {
    (void)detail::Each{(fields.expect(rows(), rows() + ghosts()), 0)...};
    (void)detail::Each{(fields.resize(rows() + ghosts()), 0)...};
    const rcbd_mpi_field raw[] = {fields.raw()...};
    check(rcbd_mpi_forward(halo_.get(), halo_->rows, raw, sizeof...(fields)));
  }

  std::unique_ptr<rcbd_mpi_halo, void (*)(rcbd_mpi_halo*)> halo_;
};

}  // namespace mpi
}  // namespace rcbd

#endif
