/* rcbd/rcbd.h: the C interface to rcbd, a service that divides the particles of a simulation into balanced parts. It is
   for C from C99 on, for C++, and for whatever language can call C. Link with -lrcbd (librcbd.so.1).

     rcbd_client *client;
     rcbd_scene *scene;
     rcbd_result *result;
     rcbd_scene_options options = RCBD_SCENE_OPTIONS;
     rcbd_positions xyz = rcbd_rows(my_xyz[0], n, 3);                   // double my_xyz[n][3]
     options.parts = 8;
     if (rcbd_connect(NULL, NULL, &client)) fail(rcbd_message());
     if (rcbd_scene_open(client, "jet", &options, &scene)) fail(rcbd_message());
     if (rcbd_step(scene, &xyz, NULL, &result)) fail(rcbd_message());   // at each step
     rcbd_release(result);

   What a scene, a part, a step, the error and the tolerance are, README.md says; docs/coupling.md says how to couple a
   solver. This header is the reference of the functions. Helpers and macros are in it alone, not in the library.

   Failures. A function that returns int returns RCBD_OK, which is 0, or another rcbd_code. rcbd_message() and
   rcbd_hint() then say what was wrong and where, and what to do. A function that failed has set the handles and
   arrays that it gives to NULL. Null or wrong handles, wrong lengths, values that are not finite and closed scenes are
   failures, never a crash; a handle that was freed is found as a rule, not always. Nothing is printed.

   Handles are counted. Whoever gets one holds it: rcbd_retain() adds a holder, rcbd_release() takes one away, and the
   last one frees it. Each that is given is to be released; a call needs a holder of its handle until it returns. A
   scene holds its client, an op its scene. Arrays and texts that belong to a handle stay valid, where they are, as long
   as somebody holds it: also after later steps, and after rcbd_close(). Results, cuts and arrays need no holder of
   their scene.

   Structs begin with their size, by which the library knows which fields the caller's version has. Begin with the macro
   of the same name (rcbd_report report = RCBD_REPORT;), which also sets the defaults. A null pointer to options means
   all defaults. Fields of later versions are added at the end, and 0 is their default.

   Shapes and units. [n][dims] is an array in C order: Fortran's x(dims, n). Rows, parts, seats and steps count from 0.
   Lengths are in the unit of the positions. Times are seconds. A flag is 0 or 1.

   Threads. Any thread may call anything. Calls of a client and its scenes take turns: a call that has waited for its
   turn until its deadline fails with RCBD_BUSY.
   Cuts, results and arrays can be read by many threads at once. Threads that the library starts take no signals.

   Floating point. Each call computes with the default environment (rounding to nearest, no traps, denormals kept), and
   gives the caller's back as it was.

   Deadlines. No call waits without one. At most 3600 s; calls without one have 60 s. Waiting for its turn counts.
   A call returns at the latest 2 s or 5 % after its deadline, whichever is more. rcbd_close() waits for the call under
   way, and so does the last rcbd_release().

   Forks. In a forked child all calls with handles of the parent fail, and leave the parent's connections alone. The
   child may connect by itself. The memory of rcbd_arrays stays shared with the parent: what either writes, both see. */
#ifndef RCBD_RCBD_H
#define RCBD_RCBD_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Of this header: 10000 major + 100 minor + patch. */
#define RCBD_VERSION 10000

/* ---- failures ---- */

typedef enum rcbd_code {
  RCBD_PENDING = -1, /* rcbd_wait: the step is still being made; not a failure */
  RCBD_OK = 0,
  RCBD_INVALID_ARGUMENT = 1,   /* a value, handle or name that can't be accepted */
  RCBD_NOT_FOUND = 2,          /* no such scene; or it has no positions yet */
  RCBD_ALREADY_EXISTS = 3,     /* the scene is there with other options */
  RCBD_BUSY = 4,               /* somebody else has the scene or seat; another thread's call took too long */
  RCBD_STALE_STEP = 6,         /* the step number is not above the last one */
  RCBD_NOT_FINITE = 8,         /* NaN or infinity in positions or weights; the message names the row */
  RCBD_PROTOCOL_ERROR = 9,     /* service and library don't understand each other */
  RCBD_TOO_LARGE = 10,         /* over a limit, or no memory */
  RCBD_NOT_AUTHORISED = 11,    /* no or wrong token, or another user's socket */
  RCBD_UNAVAILABLE = 12,       /* no service answers, or the connection was lost */
  RCBD_DEADLINE_EXCEEDED = 13, /* no answer in time, or a seat is missing */
  RCBD_ABORTED = 14,           /* the step was given up; the previous one stands */
  RCBD_IO_ERROR = 15,          /* a file can't be read or written */
  RCBD_UNSUPPORTED = 16,       /* what this service, scene or process can't do */
  RCBD_INTERNAL = 17,          /* a bug of rcbd's */
  RCBD_INTERRUPTED = 19,       /* rcbd_cancel or rcbd_interrupt */
  RCBD_NOT_CONSERVED = 20,     /* a step would lose or double particles */
  RCBD_DUPLICATE_ID = 21       /* two particles have the same id */
} rcbd_code;

/* Of the library, which may be newer than this header. */
int rcbd_version(void);
/* The name of a code: "not_found". Never null; "internal" where there is no such code. */
const char* rcbd_code_name(int code);
/* Of the last call of this thread that failed, until its next call that fails. Never null; the hint may be "". */
const char* rcbd_message(void);
const char* rcbd_hint(void);

/* ---- handles ---- */

typedef struct rcbd_client rcbd_client; /* a connection to a service */
typedef struct rcbd_scene rcbd_scene;   /* a scene, or a seat of one, that this client steps */
typedef struct rcbd_arrays rcbd_arrays; /* memory for positions that the service may read in place */
typedef struct rcbd_op rcbd_op;         /* a step that is being made */
typedef struct rcbd_result rcbd_result; /* the result of a step */
typedef struct rcbd_cuts rcbd_cuts;     /* the cuts as they were after a step */
typedef struct rcbd_lists rcbd_lists;   /* the answer to a question about cuts */

/* Any of these handles. Returns it, or NULL where it is none. */
void* rcbd_retain(void* handle);
/* NULL is allowed. The last holder of a scene or client closes it. */
void rcbd_release(void* handle);
/* A scene: lets go of it in the service, so that others may take its seat. A client: closes its scenes, and says
   goodbye. Waits for the call under way. The handle is still to be released; calls with it fail from here on. */
int rcbd_close(void* handle);

/* ---- client ---- */

typedef struct rcbd_connect_options {
  size_t size;
  const char* name;  /* how messages of the service call this client, with its process; NULL: "librcbd" */
  const char* token; /* TCP only; NULL: RCBD_TOKEN, else RCBD_TOKEN_FILE, else that of a service on this machine */
  const char* path; /* how positions go to the ranks: "auto", "shared", "direct", "gateway"; NULL: RCBD_PATH, or auto */
  double deadline_seconds;
  int32_t outlive; /* 1: calls wait until their deadline for a service that has gone; 0: that is an error at once */
  int32_t reserved;
} rcbd_connect_options;
#define RCBD_CONNECT_OPTIONS \
  { sizeof(rcbd_connect_options), NULL, NULL, NULL, 5, 1, 0 }

/* endpoint: "unix:PATH", "HOST:PORT" or "file:PATH"; NULL: RCBD_ENDPOINT, else the user's socket, else 127.0.0.1:7470.
   Fails with: unavailable, not_authorised, deadline_exceeded. */
int rcbd_connect(const char* endpoint, const rcbd_connect_options* options, rcbd_client** client);
/* What a call waits for, or that the service has come back: each such text once, the oldest first; NULL: no more.
   Doesn't wait for other threads' calls. The text is valid until this thread asks again. At most 100 are kept, the
   latest. */
const char* rcbd_notice(rcbd_client* client);
/* Ends the calls of this client that are under way, of all threads, also those that wait for their turn; where there is
   none, the next one that has to wait. They fail with `interrupted`, unless they end by themselves meanwhile. For
   signal handlers: only this function and rcbd_cancel() may be called in one. A step that was interrupted may have been
   made all the same: make the same step again to know. */
void rcbd_interrupt(rcbd_client* client);

/* ---- scene ---- */

typedef struct rcbd_scene_options {
  size_t size;
  int32_t parts;         /* 0: the scene must be there, and is taken as it is */
  int32_t dims;          /* 1 to 3 */
  const char* method;    /* NULL: "rcb"; or "bands-x", "bands-y", "bands-z" */
  const char* policy;    /* NULL: "tolerance"; or "cost": by the time that imbalance costs (step_seconds) */
  const char* positions; /* NULL: "every-step"; "when-needed": most steps send numbers in place of positions */
  const double*
      part_sizes;          /* [parts] > 0: the share of each; NULL: equal shares. Where the scene is there: not asked */
  double tolerance;        /* >= 0; infinity: never repartition by itself */
  double axis_hysteresis;  /* >= 1: a cut keeps its axis until another is longer by this factor */
  double cut_tolerance;    /* 0 to 1: how far off target new cuts may leave a part; 0: exact */
  int32_t replace;         /* 1: a scene of that name is dropped first */
  int32_t threads;         /* for counting, where the scene is made here */
  int32_t seat;            /* this process, 0 to seats - 1 */
  int32_t seats;           /* how many processes step the scene together */
  double deadline_seconds; /* for a scene or seat that somebody else holds, or that seat 0 has still to make */
} rcbd_scene_options;
#define RCBD_SCENE_OPTIONS \
  { sizeof(rcbd_scene_options), 0, 3, NULL, NULL, NULL, NULL, 0.1, 1.2, 0, 0, 1, 0, 1, 60 }

/* Makes the scene, or goes on with the one that is there, from its last step. If that one has other options than these,
   the failure is already_exists, which names one of them. Names are 1 to 64 of A-Z a-z 0-9 . _ -
   Of several seats number 0 makes the scene, and the others wait until it is there. With `replace` the others must open
   it after seat 0 has (a barrier), since they could take the old scene for the new one. Seat k of M keeps the particles
   of the parts [k parts / M, (k+1) parts / M), both rounded down.
   A scene that others have open can be opened, too; with `replace`, or as a seat that is held, only when they close it.
   Fails with: already_exists, not_found, busy, invalid_argument. */
int rcbd_scene_open(rcbd_client* client, const char* name, const rcbd_scene_options* options, rcbd_scene** scene);
/* Fails with: not_found, busy (somebody has it open). */
int rcbd_scene_drop(rcbd_client* client, const char* name);
/* The number of the last step; -1: there was none. */
int rcbd_last_step(rcbd_scene* scene, int64_t* step);

/* ---- positions ---- */

/* n positions in the caller's memory. Coordinate a of row i is axis[a][i * stride]. Only rcbd_wrap() writes there. */
typedef struct rcbd_positions {
  size_t size;
  int64_t count;
  int64_t stride; /* elements from one row to the next: dims for [count][dims], 1 for an array an axis */
  int32_t dims;
  int32_t single; /* 0: double; 1: float */
  void* axis[3];  /* the first element of each axis; unused ones are NULL */
} rcbd_positions;
#define RCBD_POSITIONS                                       \
  {                                                          \
    sizeof(rcbd_positions), 0, 1, 3, 0, { NULL, NULL, NULL } \
  }

/* An array [count][dims]. */
static inline rcbd_positions rcbd_rows(const double* xyz, int64_t count, int32_t dims) {
  rcbd_positions rows = RCBD_POSITIONS;
  int32_t a;
  rows.count = count;
  rows.stride = rows.dims = dims;
  for (a = 0; a < 3 && a < dims; ++a) rows.axis[a] = xyz ? (void*)(xyz + a) : NULL;
  return rows;
}
static inline rcbd_positions rcbd_rows_f4(const float* xyz, int64_t count, int32_t dims) {
  rcbd_positions rows = RCBD_POSITIONS;
  int32_t a;
  rows.count = count;
  rows.stride = rows.dims = dims;
  rows.single = 1;
  for (a = 0; a < 3 && a < dims; ++a) rows.axis[a] = xyz ? (void*)(xyz + a) : NULL;
  return rows;
}
/* An array [count] for each axis; y and z are NULL where there are fewer. Where arrays may be NULL, since a seat has no
   particles, set `dims` of what it gives. */
static inline rcbd_positions rcbd_axes(const double* x, const double* y, const double* z, int64_t count) {
  rcbd_positions axes = RCBD_POSITIONS;
  axes.count = count;
  axes.dims = y == NULL ? 1 : z == NULL ? 2 : 3;
  axes.axis[0] = (void*)x;
  axes.axis[1] = (void*)y;
  axes.axis[2] = (void*)z;
  return axes;
}

typedef enum rcbd_layout { RCBD_ROWS = 0, RCBD_AXES = 1 } rcbd_layout;

/* Optional: memory in which the solver may compute. Where the service is on this machine its ranks read it in place.
   Any other memory will do, too; it is copied or sent. Room for `count` positions of the scene's dims. Asked for once
   more, the values that are there stay, as far as they are of the same layout and kind; where more room is needed they
   are copied into new memory. Older handles keep theirs, which is then like any other memory. Fails with: too_large. */
int rcbd_arrays_new(rcbd_scene* scene, int64_t count, rcbd_layout layout, int32_t single, rcbd_arrays** arrays);
/* Where they are: set positions->count to fewer rows at will. */
int rcbd_arrays_positions(rcbd_arrays* arrays, rcbd_positions* positions);

/* Moves positions that are outside the box [lo, hi) into it, by whole periods hi - lo. Those inside stay as they are,
   to the bit. What lies at hi goes to lo, and so does what is rounded to it. lo, hi: [dims]; an axis with infinite
   bounds is not periodic. Fails with: not_finite (then nothing is moved), invalid_argument (a box without length). */
int rcbd_wrap(const rcbd_positions* positions, const double* lo, const double* hi);

/* ---- steps ---- */

typedef struct rcbd_step_options {
  size_t size;
  int64_t step;          /* -1: the last step + 1; 0 for the first */
  const int64_t* ids;    /* [count], distinct, >= 0: whose positions the rows are; NULL: row k is particle k, which one
                            seat alone can say, as long as its rows keep their number and order */
  const double* weights; /* [count], finite, >= 0; NULL: none, or those given last for these rows */
  int64_t inserted;      /* how many of these particles are new since the last step, */
  int64_t removed;       /* and how many are gone; both of this process, and then ids are required */
  double step_seconds;   /* computing time of the solver since its last step; < 0: not told */
  int32_t want_parts;    /* 1: rcbd_result_parts() */
  int32_t want_changed;  /* 1: rcbd_result_changed() */
  int32_t send;          /* 1: the positions travel, also where the scene does without */
  int32_t threads;       /* at most so many, or as many as the scene's options say, if that is more */
  double deadline_seconds;
} rcbd_step_options;
#define RCBD_STEP_OPTIONS \
  { sizeof(rcbd_step_options), -1, NULL, NULL, 0, 0, -1, 0, 0, 0, 1, 60 }

/* Makes a step with all rows of this process; there may be none. Returns when it is made on all ranks or on none. After
   a failure the step before stands. Only after deadline_exceeded, unavailable and interrupted, and with several seats
   aborted, the step may have been made: the same call again gives its result then.
   Where particles come or go only their number is checked, not which ones they are; ids that come twice are found.
   Fails with: not_finite, not_conserved, duplicate_id, stale_step, invalid_argument, busy (somebody else steps it, or a
   step was begun), not_found (dropped, or made anew), too_large, unsupported, and those. result: may be NULL. */
int rcbd_step(rcbd_scene* scene, const rcbd_positions* positions, const rcbd_step_options* options,
              rcbd_result** result);
/* The same, in a thread of the library, which makes the steps begun with one client one after another, in the order
   begun; each has its deadline from when it is its turn. So processes that share several scenes begin them in the same
   order, or use a client for each. Until it is done the caller's arrays must stay as they are, and its options' arrays,
   too; the structs themselves are copied. */
int rcbd_step_begin(rcbd_scene* scene, const rcbd_positions* positions, const rcbd_step_options* options, rcbd_op** op);
/* Waits at most so long (0: not at all; < 0: until it is done) and returns RCBD_PENDING if it isn't done; else what
   rcbd_step() would have. May be asked again, by any thread; each result given is to be released. It may be NULL. */
int rcbd_wait(rcbd_op* op, double seconds, rcbd_result** result);
/* Ends the step with `interrupted`, unless it is done before that is noticed: within 0.1 s, or 2 s where the service
   has gone. Of several seats it then fails for all. For other threads and signal handlers. Releasing the last handle of
   a step that isn't done cancels it and waits for that. */
void rcbd_cancel(rcbd_op* op);

/* What the service tells of a step. Texts belong to the result. */
typedef struct rcbd_report {
  size_t size;
  int64_t step;
  int64_t epoch;       /* rises whenever there are new cuts */
  int64_t n;           /* particles, of all seats */
  double error_before; /* when the positions arrived; NaN: in the first step */
  double error;        /* the largest abs(load - target) / target, now */
  double imbalance;    /* the largest load / target, now */
  int64_t drifted;     /* particles that moved across a cut since the last step; -1: not known */
  int64_t moved;       /* particles whose part new cuts changed */
  int64_t migrated;    /* of these, those that changed the service's rank */
  int64_t inserted, removed;
  int64_t strangers;                             /* particles that were outside their seat's parts */
  int64_t weights_as_zero;                       /* particles whose weight is too far below the greatest one to count */
  int64_t positions_step;                        /* the step whose positions the ranks hold; -1: none */
  int64_t bytes;                                 /* that travelled */
  int64_t scanned, searched, rounds, reductions; /* the work of the service */
  double seconds_receive, seconds_exchange, seconds_search, seconds_migrate, seconds_total;
  int32_t parts;
  int32_t axes_flipped;  /* cuts that changed their axis */
  int32_t repartitioned; /* 1: there are new cuts */
  int32_t sent;          /* 1: positions travelled in this step */
  const char* reason;    /* of the decision, in words */
  const char* way;       /* "count", "shared-memory", "sockets", "endpoint": the paths "shared", "direct", "gateway" */
  const char* json;      /* the whole report, as the service sent it */
} rcbd_report;
#define RCBD_REPORT                                                                                                \
  {                                                                                                                \
    sizeof(rcbd_report), 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, NULL, \
        NULL, NULL                                                                                                 \
  }

/* Fills in as many bytes of it as report->size says. */
int rcbd_result_report(rcbd_result* result, rcbd_report* report);
/* part: [count], the part of each row under the cuts after the step. Fails with: not_found (want_parts was 0). */
int rcbd_result_parts(rcbd_result* result, const int32_t** part, int64_t* count);
/* The rows whose part differs from what this scene told last, ascending, and their parts; all rows where they are other
   particles than then. Fails with: not_found (want_changed was 0). */
int rcbd_result_changed(rcbd_result* result, const int64_t** row, const int32_t** part, int64_t* count);
/* The rows that belong to other seats, ascending, and these: hand them over. What isn't is named again. */
int rcbd_result_leaving(rcbd_result* result, const int64_t** row, const int32_t** seat, int64_t* count);

/* ---- cuts ---- */

/* The cuts after the last step: a value that does not change. Once it is there, nothing below asks the service. Ask for
   it after each step; it costs nothing where there are no new cuts. Fails with: not_found (no positions yet). */
int rcbd_scene_cuts(rcbd_scene* scene, rcbd_cuts** cuts);

typedef struct rcbd_cuts_info {
  size_t size;
  int64_t epoch;
  uint64_t hash; /* the same for the same cuts; printed as 16 hex digits elsewhere */
  int32_t parts;
  int32_t dims;
} rcbd_cuts_info;
#define RCBD_CUTS_INFO \
  { sizeof(rcbd_cuts_info), 0, 0, 0, 0 }

int rcbd_cuts_describe(rcbd_cuts* cuts, rcbd_cuts_info* info);
/* lo, hi: [parts][dims], the region of each part; infinite where it has no bound. lo > hi: it can own no position. */
int rcbd_cuts_regions(rcbd_cuts* cuts, double* lo, double* hi);

typedef enum rcbd_norm { RCBD_MAX = 0, RCBD_EUCLID = 1 } rcbd_norm;

/* A distance from regions, across the borders of a periodic box too. */
typedef struct rcbd_near {
  size_t size;
  double width;
  const double *lo, *hi; /* [dims] each, the periodic box; NULL: none; an axis with infinite bounds is not periodic */
  int32_t norm;          /* an rcbd_norm */
  int32_t reserved;
} rcbd_near;
#define RCBD_NEAR \
  { sizeof(rcbd_near), 0, NULL, NULL, RCBD_MAX, 0 }

typedef struct rcbd_ask_options {
  size_t size;
  const int64_t* ids;       /* [count]: decide between particles that are on a cut; NULL: the row is the id */
  const int32_t* last_part; /* owner: [count], a hint that changes no answer; NULL: none */
  const double* widths;     /* halo: [count], a width for each row in place of near's; NULL: none */
  int64_t entries_max;      /* halo: more entries are an error, too_large */
  int32_t seats;            /* halo: lists for so many seats; 0: for the parts */
  int32_t threads;          /* at most so many */
} rcbd_ask_options;
#define RCBD_ASK_OPTIONS \
  { sizeof(rcbd_ask_options), NULL, NULL, NULL, 268435456, 0, 1 }

/* part: [count], set to the part that owns each position. Fails with: not_finite, invalid_argument. */
int rcbd_cuts_owner(rcbd_cuts* cuts, const rcbd_positions* positions, const rcbd_ask_options* options, int32_t* part);
/* Which of these particles, each in the region of its part, the other parts (or seats) need: a list for each, of rows,
   ascending, with shifts. A particle is needed where the part's region is within the width of it or of an image; its
   own part needs moved images alone. Fails with: not_finite, invalid_argument, too_large. */
int rcbd_cuts_halo(rcbd_cuts* cuts, const rcbd_positions* positions, const rcbd_near* near,
                   const rcbd_ask_options* options, rcbd_lists** lists);
/* One list: the parts within near's width of this part's region, ascending, with shifts. Fails with: not_found (no such
   part), invalid_argument. */
int rcbd_cuts_neighbours(rcbd_cuts* cuts, int32_t part, const rcbd_near* near, rcbd_lists** lists);
/* One list: the parts whose region touches the box [lo, hi], or one of its images, ascending; no shifts. lo, hi:
   [dims]. near: only its periodic box counts; NULL: not periodic. */
int rcbd_cuts_box(rcbd_cuts* cuts, const double* lo, const double* hi, const rcbd_near* near, rcbd_lists** lists);
/* The smallest distance between two opposite faces of a region. part is -1 where no region has two. near: as above. */
int rcbd_cuts_narrowest(rcbd_cuts* cuts, const rcbd_near* near, int32_t* part, int32_t* axis, double* width);

/* Lists one after another. They belong to the handle. */
typedef struct rcbd_lists_view {
  size_t size;
  int64_t lists;         /* how many */
  int64_t entries;       /* of all lists together */
  const int64_t* offset; /* [lists + 1]: list k has the entries from offset[k] up to, not including, offset[k + 1] */
  const int64_t* item;   /* [entries]: the rows of a halo; the parts of neighbours and boxes */
  const int32_t* shift;  /* [entries][dims]: by how many periods an entry is to be moved; NULL: there are none */
} rcbd_lists_view;
#define RCBD_LISTS_VIEW \
  { sizeof(rcbd_lists_view), 0, 0, NULL, NULL, NULL }

int rcbd_lists_read(rcbd_lists* lists, rcbd_lists_view* view);

#ifdef __cplusplus
}
#endif

#endif
