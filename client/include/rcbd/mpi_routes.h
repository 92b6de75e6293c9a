/* rcbd/mpi_routes.h: rows from process to process, for rcbd/mpi.h. For solvers it has rcbd_mpi_field alone: names
   that end with _ may change. */
#ifndef RCBD_MPI_ROUTES_H
#define RCBD_MPI_ROUTES_H

#include <limits.h>
#include <mpi.h>
#include <rcbd/rcbd.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#ifndef RCBD_MPI_TAG
#define RCBD_MPI_TAG 7470
#endif
#ifndef RCBD_MPI_COUNT_MAX
#define RCBD_MPI_COUNT_MAX INT_MAX /* what the counts of MPI can say */
#endif
#ifndef RCBD_MPI_SEATS_MAX
#define RCBD_MPI_SEATS_MAX 1024 /* of a scene */
#endif
#define RCBD_MPI_FIELDS_MAX 16 /* of one call */

/* ---- failures ---- */

typedef struct rcbd_mpi_failure_ {
  char message[1024], hint[1024];
} rcbd_mpi_failure_;

#ifdef __GNUC__ /* one for each thread, which all source files of a program share */
#ifdef __cplusplus
extern "C" {
#endif
__attribute__((weak)) __thread rcbd_mpi_failure_ rcbd_mpi_last_failure_;
#ifdef __cplusplus
}
#endif
#else
static rcbd_mpi_failure_ rcbd_mpi_last_failure_;
#endif

static inline int rcbd_mpi_fail_(int code, const char* message, const char* hint) {
  rcbd_mpi_failure_* last = &rcbd_mpi_last_failure_;
  if (message != last->message) snprintf(last->message, sizeof(last->message), "%s", message);
  if (hint != last->hint) snprintf(last->hint, sizeof(last->hint), "%s", hint);
  return code;
}

static inline int rcbd_mpi_fail_count_(int code, const char* what, int64_t count, const char* hint) {
  char message[256];
  snprintf(message, sizeof(message), "%s: %lld", what, (long long)count);
  return rcbd_mpi_fail_(code, message, hint);
}

/* What the library's last call in this thread has left to say, or that there is no such thing. */
static inline int rcbd_mpi_fail_library_(int code, const char* otherwise) {
  return rcbd_mpi_fail_(code, rcbd_message()[0] ? rcbd_message() : otherwise, rcbd_hint());
}

static inline int rcbd_mpi_fail_mpi_(int error) {
  char message[MPI_MAX_ERROR_STRING];
  int length;
  MPI_Error_string(error, message, &length);
  return rcbd_mpi_fail_(RCBD_INTERNAL, message, "");
}

static inline int rcbd_mpi_no_memory_(int64_t rows) {
  return rcbd_mpi_fail_count_(RCBD_TOO_LARGE, "no memory for rows", rows, "use more processes");
}

/* ---- arrays ---- */

/* An array of the solver's, [room][columns] elements of a type. The same fields, in the same order, on all processes.
 */
typedef struct rcbd_mpi_field {
  void* data;
  int64_t room;      /* rows it has room for */
  MPI_Datatype type; /* of an element: MPI_DOUBLE, or any other */
  int32_t columns;
  int32_t positions; /* 0: something else than positions; 1: x and, with more columns, y and z; 2: y; 3: z. Positions of
                        MPI_DOUBLE or MPI_FLOAT, which the halo moves to where a periodic image is */
} rcbd_mpi_field;

/* ---- routes: what both plans have ---- */

typedef struct rcbd_mpi_routes_ {
  MPI_Comm comm;
  int rank, size;
  const int64_t* row; /* my rows that go to others, those for process 0 first */
  int64_t *out, *in;  /* [size + 1]: the entries for and from process p begin at [p], and end before [p + 1] */
  MPI_Request* requests;
  MPI_Status* statuses;
  MPI_Datatype* types;
  char* buffer;
  size_t buffer_bytes;
} rcbd_mpi_routes_;

/* What goes of one field: its entries lie one after another where they go out and where they come in. */
typedef struct rcbd_mpi_lane_ {
  char *out, *in;
  MPI_Datatype row;
  size_t bytes; /* of a row */
} rcbd_mpi_lane_;

static inline void* rcbd_mpi_alloc_(int64_t count, size_t bytes) {
  if (count < 0 || (uint64_t)count > SIZE_MAX / 2 / bytes) return NULL;
  return calloc(count > 0 ? (size_t)count : 1, bytes);
}

static inline void rcbd_mpi_routes_free_(rcbd_mpi_routes_* routes) {
  free(routes->out);
  free(routes->in);
  free(routes->requests);
  free(routes->statuses);
  free(routes->types);
  free(routes->buffer);
}

static inline int rcbd_mpi_routes_make_(rcbd_mpi_routes_* routes, MPI_Comm comm) {
  int64_t size;
  routes->comm = comm;
  MPI_Comm_rank(comm, &routes->rank);
  MPI_Comm_size(comm, &routes->size);
  size = routes->size;
  routes->out = (int64_t*)rcbd_mpi_alloc_(size + 1, sizeof(int64_t));
  routes->in = (int64_t*)rcbd_mpi_alloc_(size + 1, sizeof(int64_t));
  routes->requests = (MPI_Request*)rcbd_mpi_alloc_(2 * size, sizeof(MPI_Request));
  routes->statuses = (MPI_Status*)rcbd_mpi_alloc_(2 * size, sizeof(MPI_Status));
  routes->types = (MPI_Datatype*)rcbd_mpi_alloc_(2 * size, sizeof(MPI_Datatype));
  if (routes->out && routes->in && routes->requests && routes->statuses && routes->types) return RCBD_OK;
  return rcbd_mpi_no_memory_(size);
}

static inline int rcbd_mpi_check_numbers_(const rcbd_mpi_routes_* routes) {
  int p;
  for (p = 0; p < routes->size; ++p)
    if (routes->out[p + 1] - routes->out[p] > RCBD_MPI_COUNT_MAX)
      return rcbd_mpi_fail_count_(RCBD_TOO_LARGE, "more rows for one process than MPI can count",
                                  routes->out[p + 1] - routes->out[p], "use more processes");
  return RCBD_OK;
}

/* Of all processes: from `out`, `in`. */
static inline int rcbd_mpi_tell_numbers_(rcbd_mpi_routes_* routes) {
  int p, error;
  for (p = 0; p < routes->size; ++p) routes->in[p + 1] = routes->out[p + 1] - routes->out[p];
  error = MPI_Alltoall(MPI_IN_PLACE, 1, MPI_INT64_T, routes->in + 1, 1, MPI_INT64_T, routes->comm);
  if (error != MPI_SUCCESS) return rcbd_mpi_fail_mpi_(error);
  for (p = 0; p < routes->size; ++p) routes->in[p + 1] += routes->in[p];
  return RCBD_OK;
}

/* The message of all lanes: so many entries from `first` on, from where they go out or to where they come in. */
typedef enum rcbd_mpi_side_ { RCBD_MPI_OUT_, RCBD_MPI_IN_ } rcbd_mpi_side_;

static inline MPI_Datatype rcbd_mpi_message_type_(const rcbd_mpi_lane_* lanes, int n, rcbd_mpi_side_ side,
                                                  int64_t first, int64_t count) {
  MPI_Datatype rows[RCBD_MPI_FIELDS_MAX], type = MPI_DATATYPE_NULL;
  MPI_Aint address[RCBD_MPI_FIELDS_MAX];
  int counts[RCBD_MPI_FIELDS_MAX], k;
  for (k = 0; k < n; ++k) {
    MPI_Get_address((side == RCBD_MPI_OUT_ ? lanes[k].out : lanes[k].in) + (size_t)first * lanes[k].bytes, &address[k]);
    counts[k] = (int)count;
    rows[k] = lanes[k].row;
  }
  MPI_Type_create_struct(n, counts, address, rows, &type);
  MPI_Type_commit(&type);
  return type;
}

/* That whole messages came. (What is longer is an error to MPI.) */
static inline int rcbd_mpi_check_received_(const rcbd_mpi_routes_* routes, int receives) {
  int k, count;
  for (k = 0; k < receives; ++k) {
    MPI_Get_count(&routes->statuses[k], routes->types[k], &count);
    if (count != 1)
      return rcbd_mpi_fail_count_(RCBD_INVALID_ARGUMENT, "other fields were sent by process",
                                  routes->statuses[k].MPI_SOURCE, "give the same fields in the same order everywhere");
  }
  return RCBD_OK;
}

/* How far a transfer has come: so many messages are under way, and the first error. */
typedef struct rcbd_mpi_begun_ {
  int used, error;
} rcbd_mpi_begun_;

/* Begins to send to, or to receive from, each process that has entries there. What could not begin is not waited for.
 */
static inline void rcbd_mpi_begin_(rcbd_mpi_routes_* routes, const int64_t* entries, const rcbd_mpi_lane_* lanes, int n,
                                   rcbd_mpi_side_ side, rcbd_mpi_begun_* begun) {
  int p, error;
  for (p = 0; p < routes->size; ++p) {
    MPI_Datatype* type = &routes->types[begun->used];
    MPI_Request* request = &routes->requests[begun->used];
    if (p == routes->rank || entries[p + 1] == entries[p]) continue;
    *type = rcbd_mpi_message_type_(lanes, n, side, entries[p], entries[p + 1] - entries[p]);
    error = side == RCBD_MPI_IN_ ? MPI_Irecv(MPI_BOTTOM, 1, *type, p, RCBD_MPI_TAG, routes->comm, request)
                                 : MPI_Isend(MPI_BOTTOM, 1, *type, p, RCBD_MPI_TAG, routes->comm, request);
    if (error != MPI_SUCCESS) *request = MPI_REQUEST_NULL;
    if (begun->error == MPI_SUCCESS) begun->error = error;
    ++begun->used;
  }
}

/* Sends the entries of all lanes, one message for each process that there are some for, and receives. */
static inline int rcbd_mpi_transfer_(rcbd_mpi_routes_* routes, const int64_t* out, const int64_t* in,
                                     const rcbd_mpi_lane_* lanes, int n) {
  const int p = routes->rank;
  rcbd_mpi_begun_ begun = {0, MPI_SUCCESS};
  int k, error, receives, code;
  rcbd_mpi_begin_(routes, in, lanes, n, RCBD_MPI_IN_, &begun);
  receives = begun.used;
  rcbd_mpi_begin_(routes, out, lanes, n, RCBD_MPI_OUT_, &begun);
  for (k = 0; k < n; ++k)
    if (out[p + 1] > out[p])
      memcpy(lanes[k].in + (size_t)in[p] * lanes[k].bytes, lanes[k].out + (size_t)out[p] * lanes[k].bytes,
             (size_t)(out[p + 1] - out[p]) * lanes[k].bytes);
  error = MPI_Waitall(begun.used, routes->requests, routes->statuses);
  if (begun.error != MPI_SUCCESS) error = begun.error;
  code = error == MPI_SUCCESS ? rcbd_mpi_check_received_(routes, receives) : rcbd_mpi_fail_mpi_(error);
  for (k = 0; k < begun.used; ++k) MPI_Type_free(&routes->types[k]);
  return code;
}

static inline int rcbd_mpi_reserve_(rcbd_mpi_routes_* routes, size_t bytes) {
  if (bytes <= routes->buffer_bytes) return RCBD_OK;
  free(routes->buffer);
  routes->buffer = (char*)malloc(bytes);
  routes->buffer_bytes = routes->buffer == NULL ? 0 : bytes;
  return routes->buffer != NULL ? RCBD_OK : rcbd_mpi_no_memory_(routes->out[routes->size]);
}

/* Copies the rows that go out of arrays, each of which is its lane's `in`, and sends from there; what comes in is to be
   at row `at` of each. */
static inline int rcbd_mpi_pack_(rcbd_mpi_routes_* routes, rcbd_mpi_lane_* lanes, int n, int64_t at) {
  const int64_t entries = routes->out[routes->size];
  size_t bytes = 0;
  int64_t e;
  int k, code;
  for (k = 0; k < n; ++k) bytes += ((size_t)entries * lanes[k].bytes + 15) / 16 * 16; /* where any type may begin */
  code = rcbd_mpi_reserve_(routes, bytes);
  if (code != RCBD_OK) return code;
  for (bytes = 0, k = 0; k < n; ++k) {
    rcbd_mpi_lane_* lane = &lanes[k];
    lane->out = routes->buffer + bytes;
    for (e = 0; e < entries; ++e)
      memcpy(lane->out + (size_t)e * lane->bytes, lane->in + (size_t)routes->row[e] * lane->bytes, lane->bytes);
    if (at > 0) lane->in += (size_t)at * lane->bytes; /* else it may be NULL */
    bytes += ((size_t)entries * lane->bytes + 15) / 16 * 16;
  }
  return RCBD_OK;
}

static inline void rcbd_mpi_free_lanes_(rcbd_mpi_lane_* lanes, int n) {
  int k;
  for (k = 0; k < n; ++k) MPI_Type_free(&lanes[k].row);
}

/* ---- fields by routes ---- */

static inline int rcbd_mpi_check_fields_(const rcbd_mpi_field* fields, int n, int64_t rows) {
  int k;
  if (n < 1 || n > RCBD_MPI_FIELDS_MAX || fields == NULL)
    return rcbd_mpi_fail_count_(RCBD_INVALID_ARGUMENT, "not 1 to 16 fields, but", fields == NULL ? 0 : n, "");
  for (k = 0; k < n; ++k) {
    if (fields[k].columns < 1)
      return rcbd_mpi_fail_count_(RCBD_INVALID_ARGUMENT, "a field's columns", fields[k].columns, "");
    if (fields[k].room < rows || (fields[k].data == NULL && rows > 0)) {
      char message[256];
      snprintf(message, sizeof(message), "field %d has room for %lld rows, not for %lld", k,
               fields[k].data == NULL ? 0LL : (long long)fields[k].room, (long long)rows);
      return rcbd_mpi_fail_(RCBD_INVALID_ARGUMENT, message, "make the array larger once the plan is made");
    }
  }
  return RCBD_OK;
}

static inline void rcbd_mpi_make_lanes_(const rcbd_mpi_field* fields, int n, rcbd_mpi_lane_* lanes) {
  MPI_Aint lb, extent;
  int k;
  for (k = 0; k < n; ++k) {
    MPI_Type_get_extent(fields[k].type, &lb, &extent);
    MPI_Type_contiguous(fields[k].columns, fields[k].type, &lanes[k].row);
    lanes[k].bytes = (size_t)extent * (size_t)fields[k].columns;
    lanes[k].out = lanes[k].in = (char*)fields[k].data;
  }
}

/* Rows of an array that are to be closed up over. */
typedef struct rcbd_mpi_gaps_ {
  const int64_t* row; /* ascending */
  int64_t count, rows;
} rcbd_mpi_gaps_;

static inline void rcbd_mpi_close_gaps_(const rcbd_mpi_gaps_* gaps, char* data, size_t bytes) {
  int64_t k;
  for (k = 0; k < gaps->count; ++k) {
    const int64_t from = gaps->row[k] + 1, to = k + 1 < gaps->count ? gaps->row[k + 1] : gaps->rows;
    memmove(data + (size_t)(from - k - 1) * bytes, data + (size_t)from * bytes, (size_t)(to - from) * bytes);
  }
}

/* Sends the rows that go out of all fields; what comes is from row `at` on. gaps: NULL where the rows stay, too. */
static inline int rcbd_mpi_exchange_(rcbd_mpi_routes_* routes, const rcbd_mpi_field* fields, int n, int64_t at,
                                     const rcbd_mpi_gaps_* gaps) {
  rcbd_mpi_lane_ lanes[RCBD_MPI_FIELDS_MAX];
  int k, code;
  rcbd_mpi_make_lanes_(fields, n, lanes);
  code = rcbd_mpi_pack_(routes, lanes, n, at);
  for (k = 0; k < n && gaps != NULL && code == RCBD_OK; ++k)
    rcbd_mpi_close_gaps_(gaps, (char*)fields[k].data, lanes[k].bytes);
  if (code == RCBD_OK) code = rcbd_mpi_transfer_(routes, routes->out, routes->in, lanes, n);
  rcbd_mpi_free_lanes_(lanes, n);
  return code;
}

/* ---- whose rows ---- */

/* That all rows are in the regions of this seat's parts: the halo of others would be plausible, and wrong. */
static inline int rcbd_mpi_check_owned_(const rcbd_mpi_routes_* routes, rcbd_cuts* cuts, int64_t parts,
                                        const rcbd_positions* positions, const rcbd_ask_options* options) {
  const int64_t first = parts * routes->rank / routes->size, end = parts * (routes->rank + 1) / routes->size;
  rcbd_ask_options ask = RCBD_ASK_OPTIONS;
  int32_t* part = (int32_t*)rcbd_mpi_alloc_(positions->count, sizeof(int32_t));
  int64_t k, others = 0;
  int code;
  char message[100];
  if (part == NULL) return rcbd_mpi_no_memory_(positions->count);
  ask.ids = options->ids;
  ask.threads = options->threads;
  code = rcbd_cuts_owner(cuts, positions, &ask, part);
  for (k = 0; k < positions->count && code == RCBD_OK; ++k) others += part[k] < first || part[k] >= end;
  free(part);
  if (code != RCBD_OK) return rcbd_mpi_fail_library_(code, "");
  if (others == 0) return RCBD_OK;
  snprintf(message, sizeof(message), "%lld of %lld rows belong to other processes", (long long)others,
           (long long)positions->count);
  return rcbd_mpi_fail_(RCBD_INVALID_ARGUMENT, message,
                        "hand them over after the step (moves), and give the positions and ids that it had");
}

/* ---- adding what came to my rows ---- */

/* Sums of integers wrap around. */
#define RCBD_MPI_ADD_(T, U)                                                            \
  for (k = 0; k < routes->out[routes->size]; ++k)                                      \
    for (c = 0; c < columns; ++c) {                                                    \
      T* to = (T*)data + routes->row[k] * columns + c;                                 \
      *to = (T)((U)*to + (U)((const T*)(const void*)routes->buffer)[k * columns + c]); \
    }

static inline void rcbd_mpi_add_(const rcbd_mpi_routes_* routes, void* data, char kind, int32_t columns) {
  int64_t k;
  int32_t c;
  if (kind == 'd') RCBD_MPI_ADD_(double, double)
  if (kind == 'f') RCBD_MPI_ADD_(float, float)
  if (kind == 'i') RCBD_MPI_ADD_(int32_t, uint32_t)
  if (kind == 'l') RCBD_MPI_ADD_(int64_t, uint64_t)
}
#undef RCBD_MPI_ADD_

/* As rcbd_mpi_add_() takes it; 0: it doesn't. */
static inline char rcbd_mpi_kind_(MPI_Datatype type) {
  if (type == MPI_DOUBLE) return 'd';
  if (type == MPI_FLOAT) return 'f';
  if (type == MPI_INT32_T || type == MPI_INT) return 'i';
  return type == MPI_INT64_T || type == MPI_LONG_LONG || (type == MPI_LONG && sizeof(long) == 8) ? 'l' : 0;
}

#endif
