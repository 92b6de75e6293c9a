/* rcbd/mpi.h: what the processes of a solver send to each other, over the solver's own MPI: particles that are handed
   over after a step, and the halo. For C from C99 and C++ from C++14 on; of MPI 3 and librcbd alone. All of it is in
   this header: the library itself knows no MPI.

     must(rcbd_mpi_connect(comm, NULL, NULL, &client));
     must(rcbd_mpi_scene_open(comm, client, "jet", &options, &scene));        // process k of M is seat k of M

     must(rcbd_mpi_step(comm, scene, &positions, &step, &result));            // when lists are rebuilt
     must(rcbd_mpi_moves_new(comm, result, n, &moves));
     grow(moves->rows);                                                       // to that many rows
     must(rcbd_mpi_move(moves, fields, 3));
     rcbd_scene_cuts(scene, &cuts);
     must(rcbd_mpi_halo_new(comm, cuts, &positions, &near, &ask, &halo));
     grow(halo->rows + halo->ghosts);

     must(rcbd_mpi_forward(halo, n, fields, 2));                              // at each time step
     must(rcbd_mpi_reverse_add(halo, n, &force));

   client/examples/c/dem.c is a whole solver.

   Failures. A function that returns int returns RCBD_OK or another rcbd_code; rcbd_mpi_message() and rcbd_mpi_hint()
   tell of it. Functions that take a communicator are called by all its processes, and fail for all of them if they do
   for one, with that one's code and text. To that end they take what could not be made before as NULL: the client that
   did not connect, the result of a step that failed, cuts that are not there. What else fails on one process the solver
   lets all know by rcbd_mpi_agree(), since nobody may wait for one that has given up. rcbd_mpi_move(),
   rcbd_mpi_forward() and rcbd_mpi_reverse_add() fail on one process alone, before it sends anything, where they are
   called wrongly or there is no memory: end with MPI_Abort then.

   Order. The rows of each process stay in their order. Those that come from others follow, by process, and by row where
   they come from. So the same run has the same rows on each process each time.

   Messages go over the communicator that is given, with the tag RCBD_MPI_TAG, only between processes that have rows for
   each other, and not from a process to itself. A communicator on which the solver receives with MPI_ANY_TAG meanwhile
   would lose them: give a duplicate (MPI_Comm_dup). Plans use theirs until they are freed. At most RCBD_MPI_COUNT_MAX
   rows go from one process to another at once: what is more is refused (too_large), not cut in pieces. */
#ifndef RCBD_MPI_H
#define RCBD_MPI_H

#include <rcbd/mpi_routes.h>

/* ---- failures ---- */

/* Of the last of these functions that failed in this thread. Never null. */
static inline const char* rcbd_mpi_message(void) { return rcbd_mpi_last_failure_.message; }
static inline const char* rcbd_mpi_hint(void) { return rcbd_mpi_last_failure_.hint; }

/* Of all processes: RCBD_OK where all have that code. Otherwise the code and text of the first process that has not;
   aborted and deadline_exceeded, which may follow from what failed on another one, come after all others. A solver uses
   it where it finds something wrong itself, too, so that all end together. */
static inline int rcbd_mpi_agree(MPI_Comm comm, int code, const char* message, const char* hint) {
  rcbd_mpi_failure_ told;
  int rank, size, mine, first, error;
  MPI_Comm_rank(comm, &rank);
  MPI_Comm_size(comm, &size);
  mine = code == RCBD_ABORTED || code == RCBD_DEADLINE_EXCEEDED ? size + rank : rank;
  if (code == RCBD_OK) mine = 2 * size;
  error = MPI_Allreduce(&mine, &first, 1, MPI_INT, MPI_MIN, comm);
  if (error != MPI_SUCCESS) return rcbd_mpi_fail_mpi_(error);
  if (first == 2 * size) return RCBD_OK;
  first %= size;
  memset(&told, 0, sizeof(told));
  if (first == rank) {
    snprintf(told.message, sizeof(told.message), "process %d: %.1000s", rank, message);
    snprintf(told.hint, sizeof(told.hint), "%s", hint);
  }
  error = MPI_Bcast(&code, 1, MPI_INT, first, comm);
  if (error == MPI_SUCCESS) error = MPI_Bcast(&told, (int)sizeof(told), MPI_CHAR, first, comm);
  if (error != MPI_SUCCESS) return rcbd_mpi_fail_mpi_(error);
  return rcbd_mpi_fail_(code, told.message, told.hint);
}

static inline int rcbd_mpi_agree_(MPI_Comm comm, int code) {
  return rcbd_mpi_agree(comm, code, rcbd_mpi_message(), rcbd_mpi_hint());
}

/* ---- client, scene, step ---- */

/* Of all processes: rcbd_connect(), each for itself. */
static inline int rcbd_mpi_connect(MPI_Comm comm, const char* endpoint, const rcbd_connect_options* options,
                                   rcbd_client** client) {
  int code = rcbd_connect(endpoint, options, client);
  if (code != RCBD_OK) rcbd_mpi_fail_library_(code, "");
  code = rcbd_mpi_agree_(comm, code);
  if (code != RCBD_OK && client != NULL) {
    rcbd_release(*client);
    *client = NULL;
  }
  return code;
}

/* Of all processes: rcbd_scene_open() with seat and seats from the communicator, the others after process 0, so that
   `replace` needs no more care. More than 1,024 processes are refused: docs/coupling.md says what larger jobs do. */
static inline int rcbd_mpi_scene_open(MPI_Comm comm, rcbd_client* client, const char* name,
                                      const rcbd_scene_options* options, rcbd_scene** scene) {
  rcbd_scene_options mine = RCBD_SCENE_OPTIONS;
  int turn, code = RCBD_OK;
  if (options != NULL) mine = *options;
  MPI_Comm_rank(comm, &mine.seat);
  MPI_Comm_size(comm, &mine.seats);
  if (scene == NULL)
    code = rcbd_mpi_fail_(RCBD_INVALID_ARGUMENT, "no room for the scene: a null pointer", "");
  else
    *scene = NULL;
  if (code == RCBD_OK && client == NULL) code = rcbd_mpi_fail_library_(RCBD_UNAVAILABLE, "no client: a null handle");
  if (code == RCBD_OK && mine.seats > RCBD_MPI_SEATS_MAX)
    code = rcbd_mpi_fail_count_(RCBD_TOO_LARGE, "more processes than a scene may have seats", mine.seats,
                                "let one process of each node open it: docs/coupling.md");
  for (turn = 0; turn < 2; ++turn) {
    if (code == RCBD_OK && (mine.seat == 0) == (turn == 0)) {
      code = rcbd_scene_open(client, name, &mine, scene);
      if (code != RCBD_OK) rcbd_mpi_fail_(code, rcbd_message(), rcbd_hint());
    }
    code = rcbd_mpi_agree_(comm, code);
    if (code != RCBD_OK) break;
  }
  if (code != RCBD_OK && scene != NULL) {
    rcbd_release(*scene);
    *scene = NULL;
  }
  return code;
}

/* Of all processes: rcbd_step(). Where it fails on one, that one closes its scene, so that the others don't wait for
   its seat, and it fails for all. Then the scene is to be opened again. result: may be NULL. */
static inline int rcbd_mpi_step(MPI_Comm comm, rcbd_scene* scene, const rcbd_positions* positions,
                                const rcbd_step_options* options, rcbd_result** result) {
  int code = rcbd_step(scene, positions, options, result);
  if (code != RCBD_OK) {
    rcbd_mpi_fail_library_(code, "");
    rcbd_close(scene);
  }
  code = rcbd_mpi_agree_(comm, code);
  if (code != RCBD_OK && result != NULL) {
    rcbd_release(*result);
    *result = NULL;
  }
  return code;
}

/* ---- handing over ---- */

typedef struct rcbd_mpi_moves {
  int64_t rows;   /* of this process after the moves */
  int64_t before; /* and before them */
  int64_t coming; /* of `rows`, the last ones: those of other processes */
  rcbd_result* result_;
  const int64_t* leaving_; /* ascending */
  int64_t* row_;
  rcbd_mpi_routes_ routes_;
} rcbd_mpi_moves;

static inline void rcbd_mpi_moves_free(rcbd_mpi_moves* moves) {
  if (moves == NULL) return;
  rcbd_release(moves->result_);
  free(moves->row_);
  rcbd_mpi_routes_free_(&moves->routes_);
  free(moves);
}

/* The rows that leave, by process. */
static inline int rcbd_mpi_moves_make_(rcbd_mpi_moves* moves, MPI_Comm comm, rcbd_result* result) {
  const int32_t* seat;
  int64_t count, k;
  int p, code;
  if (moves == NULL) return rcbd_mpi_no_memory_(1);
  code = rcbd_mpi_routes_make_(&moves->routes_, comm);
  if (code != RCBD_OK) return code;
  if (result == NULL) return rcbd_mpi_fail_library_(RCBD_ABORTED, "no result of a step: a null handle");
  code = rcbd_result_leaving(result, &moves->leaving_, &seat, &count);
  if (code != RCBD_OK) return rcbd_mpi_fail_library_(code, "");
  moves->result_ = (rcbd_result*)rcbd_retain(result);
  if (moves->before < 0 || (count > 0 && moves->leaving_[count - 1] >= moves->before))
    return rcbd_mpi_fail_count_(RCBD_INVALID_ARGUMENT, "a row leaves that isn't there; rows", moves->before,
                                "give the number of rows of the step");
  moves->row_ = (int64_t*)rcbd_mpi_alloc_(count, sizeof(int64_t));
  if (moves->row_ == NULL) return rcbd_mpi_no_memory_(count);
  for (k = 0; k < count; ++k) {
    if (seat[k] >= moves->routes_.size)
      return rcbd_mpi_fail_count_(RCBD_INVALID_ARGUMENT, "rows leave for a seat that no process has", seat[k],
                                  "open the scene with this communicator (rcbd_mpi_scene_open)");
    ++moves->routes_.out[seat[k] + 1];
  }
  for (p = 0; p < moves->routes_.size; ++p)
    moves->routes_.in[p + 1] = moves->routes_.out[p + 1] += moves->routes_.out[p];
  for (k = 0; k < count; ++k) moves->row_[moves->routes_.in[seat[k]]++] = moves->leaving_[k];
  memset(moves->routes_.in, 0, (size_t)(moves->routes_.size + 1) * sizeof(int64_t));
  moves->routes_.row = moves->row_;
  return rcbd_mpi_check_numbers_(&moves->routes_);
}

/* Of all processes, after a step: which rows go where, and how many come. `rows`: how many this process has. NULL in
   place of the result: a step by rcbd_step() has failed here. Then close the scene first, as rcbd_mpi_step() does. Free
   the moves when all arrays are moved. */
static inline int rcbd_mpi_moves_new(MPI_Comm comm, rcbd_result* result, int64_t rows, rcbd_mpi_moves** moves) {
  rcbd_mpi_moves* made = (rcbd_mpi_moves*)calloc(1, sizeof(rcbd_mpi_moves));
  int code;
  if (made != NULL) made->before = rows;
  code = rcbd_mpi_moves_make_(made, comm, result);
  if (moves == NULL)
    code = rcbd_mpi_fail_(RCBD_INVALID_ARGUMENT, "no room for the moves: a null pointer", "");
  else
    *moves = NULL;
  code = rcbd_mpi_agree_(comm, code);
  if (code == RCBD_OK) code = rcbd_mpi_tell_numbers_(&made->routes_);
  if (code != RCBD_OK) {
    rcbd_mpi_moves_free(made);
    return code;
  }
  made->coming = made->routes_.in[made->routes_.size];
  made->rows = rows - made->routes_.out[made->routes_.size] + made->coming;
  *moves = made;
  return RCBD_OK;
}

/* Moves the rows of n arrays, in one message for each process that some go to. Each has room for both `before` and
   `rows`. May be called for as many arrays as there are, once for each. */
static inline int rcbd_mpi_move(rcbd_mpi_moves* moves, const rcbd_mpi_field* fields, int n) {
  rcbd_mpi_gaps_ gaps;
  int code;
  if (moves == NULL) return rcbd_mpi_fail_(RCBD_INVALID_ARGUMENT, "no moves: a null pointer", "");
  gaps.row = moves->leaving_;
  gaps.count = moves->routes_.out[moves->routes_.size];
  gaps.rows = moves->before;
  code = rcbd_mpi_check_fields_(fields, n, moves->rows > moves->before ? moves->rows : moves->before);
  if (code != RCBD_OK) return code;
  return rcbd_mpi_exchange_(&moves->routes_, fields, n, moves->rows - moves->coming, &gaps);
}

/* ---- halo ---- */

typedef struct rcbd_mpi_halo {
  int64_t rows;   /* of this process */
  int64_t ghosts; /* copies of other processes' rows, and of periodic images: the rows after these, by process */
  int32_t dims;
  rcbd_lists* lists_;
  double* shift_; /* [ghosts][dims]: what is to be added to positions */
  rcbd_mpi_routes_ routes_;
} rcbd_mpi_halo;

static inline void rcbd_mpi_halo_free(rcbd_mpi_halo* halo) {
  if (halo == NULL) return;
  rcbd_release(halo->lists_);
  free(halo->shift_);
  rcbd_mpi_routes_free_(&halo->routes_);
  free(halo);
}

static inline int rcbd_mpi_halo_make_(rcbd_mpi_halo* halo, MPI_Comm comm, rcbd_cuts* cuts,
                                      const rcbd_positions* positions, const rcbd_near* near,
                                      const rcbd_ask_options* options) {
  rcbd_ask_options ask = RCBD_ASK_OPTIONS;
  rcbd_cuts_info info = RCBD_CUTS_INFO;
  rcbd_lists_view view = RCBD_LISTS_VIEW;
  int code;
  if (halo == NULL) return rcbd_mpi_no_memory_(1);
  code = rcbd_mpi_routes_make_(&halo->routes_, comm);
  if (code != RCBD_OK) return code;
  if (cuts == NULL) return rcbd_mpi_fail_library_(RCBD_ABORTED, "no cuts: a null handle");
  if (options != NULL) ask = *options;
  ask.seats = halo->routes_.size;
  code = rcbd_cuts_describe(cuts, &info);
  if (code == RCBD_OK) code = rcbd_cuts_halo(cuts, positions, near, &ask, &halo->lists_);
  if (code == RCBD_OK) code = rcbd_lists_read(halo->lists_, &view);
  if (code != RCBD_OK) return rcbd_mpi_fail_library_(code, "");
  code = rcbd_mpi_check_owned_(&halo->routes_, cuts, info.parts, positions, &ask);
  if (code != RCBD_OK) return code;
  halo->rows = positions->count;
  halo->dims = info.dims;
  halo->routes_.row = view.item;
  memcpy(halo->routes_.out, view.offset, (size_t)(halo->routes_.size + 1) * sizeof(int64_t));
  return rcbd_mpi_check_numbers_(&halo->routes_);
}

/* Of all processes: tells those that get entries by how much each is shifted. */
static inline int rcbd_mpi_tell_shifts_(rcbd_mpi_halo* halo, const rcbd_near* near) {
  rcbd_mpi_routes_* routes = &halo->routes_;
  const int64_t entries = routes->out[routes->size] * halo->dims;
  double* mine = (double*)rcbd_mpi_alloc_(entries, sizeof(double));
  rcbd_lists_view view = RCBD_LISTS_VIEW;
  rcbd_mpi_lane_ lane;
  int64_t k;
  int code;
  halo->shift_ = (double*)rcbd_mpi_alloc_(halo->ghosts * halo->dims, sizeof(double));
  code = mine != NULL && halo->shift_ != NULL ? RCBD_OK : rcbd_mpi_no_memory_(halo->ghosts);
  code = rcbd_mpi_agree_(routes->comm, code);
  if (code == RCBD_OK) {
    rcbd_lists_read(halo->lists_, &view);
    for (k = 0; view.shift != NULL && k < entries; ++k)
      if (view.shift[k] != 0) mine[k] = view.shift[k] * (near->hi[k % halo->dims] - near->lo[k % halo->dims]);
    lane.out = (char*)mine;
    lane.in = (char*)halo->shift_;
    lane.bytes = (size_t)halo->dims * sizeof(double);
    MPI_Type_contiguous(halo->dims, MPI_DOUBLE, &lane.row);
    code = rcbd_mpi_transfer_(routes, routes->out, routes->in, &lane, 1);
    rcbd_mpi_free_lanes_(&lane, 1);
  }
  free(mine);
  return code;
}

/* Of all processes, when lists are rebuilt: which rows the others need, by rcbd_cuts_halo() with these arguments (but
   `seats` of the options), and how many ghosts come. The rows are those of a step whose moves are made; those that
   belong to others are refused. NULL in place of the cuts: there are none here. A plan is good until the next step. */
static inline int rcbd_mpi_halo_new(MPI_Comm comm, rcbd_cuts* cuts, const rcbd_positions* positions,
                                    const rcbd_near* near, const rcbd_ask_options* options, rcbd_mpi_halo** halo) {
  rcbd_mpi_halo* made = (rcbd_mpi_halo*)calloc(1, sizeof(rcbd_mpi_halo));
  int code = rcbd_mpi_halo_make_(made, comm, cuts, positions, near, options);
  if (halo == NULL)
    code = rcbd_mpi_fail_(RCBD_INVALID_ARGUMENT, "no room for the halo: a null pointer", "");
  else
    *halo = NULL;
  code = rcbd_mpi_agree_(comm, code);
  if (code == RCBD_OK) code = rcbd_mpi_tell_numbers_(&made->routes_);
  if (code == RCBD_OK) {
    made->ghosts = made->routes_.in[made->routes_.size];
    code = rcbd_mpi_tell_shifts_(made, near);
  }
  if (code == RCBD_OK)
    *halo = made;
  else
    rcbd_mpi_halo_free(made);
  return code;
}

static inline int rcbd_mpi_check_halo_(const rcbd_mpi_halo* halo, int64_t rows, const rcbd_mpi_field* fields, int n) {
  int k;
  if (rows != halo->rows)
    return rcbd_mpi_fail_count_(RCBD_INVALID_ARGUMENT, "the halo was made for another number of rows", halo->rows,
                                "make a new one after each step");
  for (k = 0; k < n && fields != NULL; ++k)
    if (fields[k].positions && (fields[k].positions < 1 || fields[k].positions - 1 > halo->dims - fields[k].columns ||
                                (fields[k].type != MPI_DOUBLE && fields[k].type != MPI_FLOAT)))
      return rcbd_mpi_fail_count_(RCBD_INVALID_ARGUMENT,
                                  "positions that aren't MPI_DOUBLE or MPI_FLOAT, or of more axes than the cuts",
                                  halo->dims, "");
  return rcbd_mpi_check_fields_(fields, n, halo->rows + halo->ghosts);
}

/* Moves the ghosts' positions to where the images are. */
static inline void rcbd_mpi_shift_(const rcbd_mpi_halo* halo, const rcbd_mpi_field* field) {
  const int64_t first = halo->rows * field->columns;
  int64_t k;
  int32_t c;
  for (k = 0; k < halo->ghosts; ++k)
    for (c = 0; c < field->columns; ++c) {
      const double shift = halo->shift_[k * halo->dims + field->positions - 1 + c];
      if (shift == 0) continue; /* as it is: -0, too */
      if (field->type == MPI_DOUBLE) {
        double* x = (double*)field->data + first + k * field->columns + c;
        *x += shift;
      } else {
        float* x = (float*)field->data + first + k * field->columns + c;
        *x = (float)((double)*x + shift);
      }
    }
}

/* Fills in the ghosts' rows of n arrays from those of their owners, in one message for each process that needs some.
   `rows`: how many this process has, without ghosts. */
static inline int rcbd_mpi_forward(rcbd_mpi_halo* halo, int64_t rows, const rcbd_mpi_field* fields, int n) {
  int k, code;
  if (halo == NULL) return rcbd_mpi_fail_(RCBD_INVALID_ARGUMENT, "no halo: a null pointer", "");
  code = rcbd_mpi_check_halo_(halo, rows, fields, n);
  if (code == RCBD_OK) code = rcbd_mpi_exchange_(&halo->routes_, fields, n, halo->rows, NULL);
  for (k = 0; k < n && code == RCBD_OK; ++k)
    if (fields[k].positions) rcbd_mpi_shift_(halo, &fields[k]);
  return code;
}

/* Adds the ghosts' rows of an array of MPI_DOUBLE, MPI_FLOAT, MPI_INT32_T or MPI_INT64_T to those of their owners,
   always in the same order: by the ghosts' process, then by the owner's row. The ghosts' rows stay as they are. */
static inline int rcbd_mpi_reverse_add(rcbd_mpi_halo* halo, int64_t rows, const rcbd_mpi_field* field) {
  rcbd_mpi_routes_* routes;
  rcbd_mpi_lane_ lane;
  int code;
  if (halo == NULL) return rcbd_mpi_fail_(RCBD_INVALID_ARGUMENT, "no halo: a null pointer", "");
  routes = &halo->routes_;
  code = rcbd_mpi_check_halo_(halo, rows, field, 1);
  if (code == RCBD_OK && !rcbd_mpi_kind_(field->type))
    code = rcbd_mpi_fail_(RCBD_UNSUPPORTED, "rows are added of int32, int64, float and double alone", "");
  if (code != RCBD_OK) return code;
  rcbd_mpi_make_lanes_(field, 1, &lane);
  code = rcbd_mpi_reserve_(routes, (size_t)routes->out[routes->size] * lane.bytes);
  if (code == RCBD_OK) {
    if (halo->rows > 0) lane.out += (size_t)halo->rows * lane.bytes;
    lane.in = routes->buffer;
    code = rcbd_mpi_transfer_(routes, routes->in, routes->out, &lane, 1);
  }
  rcbd_mpi_free_lanes_(&lane, 1);
  if (code == RCBD_OK) rcbd_mpi_add_(routes, field->data, rcbd_mpi_kind_(field->type), field->columns);
  return code;
}

#endif
