/* A random scene of which each process knows all: by its seed. */
#include <math.h>
#include <rcbd/mpi.h>

enum { PROCESSES = 8 };

static int rank, size;
static unsigned random_seed;

static void ensure(int right, const char* what) {
  if (right) return;
  fprintf(stderr, "process %d of %d, seed %u: wrong: %s (%s)\n", rank, size, random_seed, what, rcbd_mpi_message());
  MPI_Abort(MPI_COMM_WORLD, 1);
}

static void well(int code) { ensure(code == RCBD_OK, code ? "a call has failed" : ""); }

static void begin(int* count, char*** word) {
  MPI_Init(count, word);
  MPI_Comm_rank(MPI_COMM_WORLD, &rank);
  MPI_Comm_size(MPI_COMM_WORLD, &size);
}

/* The same on all processes: 0 to below 1. */
static uint64_t random_state;
static double uniform(void) {
  random_state = random_state * 6364136223846793005u + 1442695040888963407u;
  return (double)(random_state >> 11) / 9007199254740992.0;
}

typedef struct scene_of_all {
  int dims, parts;
  double width, lo[3], hi[3]; /* periodic where finite */
  int64_t n;
  double* x;     /* [n][dims] */
  int32_t* seat; /* [n], after the step */
  int64_t* order[PROCESSES];
  int64_t count[PROCESSES]; /* order[p]: the ids of process p */
  double *region_lo, *region_hi;
  rcbd_scene* scene;
  rcbd_cuts* cuts;
} scene_of_all;

static void make_scene(scene_of_all* s, rcbd_client* client, unsigned seed) {
  rcbd_scene_options options = RCBD_SCENE_OPTIONS;
  char name[40];
  int64_t k;
  int a, p, first;
  random_seed = seed;
  random_state = seed;
  memset(s, 0, sizeof(*s));
  s->dims = 1 + (int)seed % 3;
  s->parts = size * (1 + (int)(seed / 3) % 3) + (int)(seed / 4) % 2;
  s->n = seed % 5 == 4 ? seed % 3 : 20 + (int64_t)(uniform() * 60);
  s->width = 0.02 + 0.2 * uniform() + 0.6 * (seed % 6 == 5); /* the last: several images of one particle */
  s->x = calloc((size_t)(s->n * s->dims) + 1, 8);
  s->seat = calloc((size_t)s->n + 1, 4);
  s->region_lo = calloc((size_t)(s->parts * s->dims), 8);
  s->region_hi = calloc((size_t)(s->parts * s->dims), 8);
  for (a = 0; a < 3; ++a) {
    s->lo[a] = uniform() < 0.4 ? -INFINITY : 0.1;
    s->hi[a] = s->lo[a] < 0 ? INFINITY : 1.3;
  }
  for (k = 0; k < s->n * s->dims; ++k) s->x[k] = 0.1 + floor(40 * 1.2 * uniform()) / 40; /* some on cuts */
  first = (int)(uniform() * size);
  for (p = 0; p < size; ++p) s->order[p] = calloc((size_t)s->n + 1, 8);
  for (k = 0; k < s->n; ++k) { /* with some seeds one process has all */
    p = seed % 4 == 1 ? first : (int)(uniform() * size);
    s->order[p][s->count[p]++] = k;
  }
  options.parts = s->parts;
  options.dims = s->dims;
  options.replace = 1;
  snprintf(name, sizeof(name), "rows-%u", seed);
  well(rcbd_mpi_scene_open(MPI_COMM_WORLD, client, name, &options, &s->scene));
}

static double* rows_of(const scene_of_all* s, int64_t* ids) {
  double* x = calloc((size_t)s->n + 1, 24);
  int64_t k;
  for (k = 0; k < s->count[rank]; ++k) {
    ids[k] = s->order[rank][k];
    memcpy(x + k * s->dims, s->x + ids[k] * s->dims, (size_t)s->dims * 8);
  }
  return x;
}

static rcbd_result* step_scene(scene_of_all* s) {
  int64_t* ids = calloc((size_t)s->n + 1, 8);
  double* x = rows_of(s, ids);
  const rcbd_positions positions = rcbd_rows(x, s->count[rank], s->dims);
  rcbd_step_options step = RCBD_STEP_OPTIONS;
  rcbd_result* result;
  step.ids = ids;
  well(rcbd_mpi_step(MPI_COMM_WORLD, s->scene, &positions, &step, &result));
  well(rcbd_scene_cuts(s->scene, &s->cuts));
  free(ids);
  free(x);
  return result;
}

/* Regions, and the seat of each particle. */
static inline void look_up(scene_of_all* s) {
  const rcbd_positions all = rcbd_rows(s->x, s->n, s->dims);
  int64_t k;
  well(rcbd_cuts_regions(s->cuts, s->region_lo, s->region_hi));
  well(rcbd_cuts_owner(s->cuts, &all, NULL, s->seat));
  for (k = 0; k < s->n; ++k) s->seat[k] = ((s->seat[k] + 1) * size - 1) / s->parts;
}

/* After the moves: process p has the ids of its seat in this order. */
static inline void take_over(scene_of_all* s) {
  int64_t* from[PROCESSES];
  int64_t n[PROCESSES] = {0}, k;
  int p, q, r;
  for (p = 0; p < size; ++p) from[p] = calloc((size_t)s->n + 1, 8);
  for (r = 0; r < size; ++r)
    for (q = 0; q < size; ++q) {
      p = q == 0 ? r : q <= r ? q - 1 : q;
      for (k = 0; k < s->count[p]; ++k)
        if (s->seat[s->order[p][k]] == r) from[r][n[r]++] = s->order[p][k];
    }
  for (p = 0; p < size; ++p) {
    free(s->order[p]);
    s->order[p] = from[p];
    s->count[p] = n[p];
  }
}

static inline rcbd_mpi_halo* make_halo(scene_of_all* s) {
  int64_t* ids = calloc((size_t)s->n + 1, 8);
  double* x = rows_of(s, ids);
  const rcbd_positions positions = rcbd_rows(x, s->count[rank], s->dims);
  rcbd_near near = RCBD_NEAR;
  rcbd_ask_options ask = RCBD_ASK_OPTIONS;
  rcbd_mpi_halo* halo;
  near.width = s->width;
  near.lo = s->lo;
  near.hi = s->hi;
  ask.ids = ids;
  well(rcbd_mpi_halo_new(MPI_COMM_WORLD, s->cuts, &positions, &near, &ask, &halo));
  free(ids);
  free(x);
  return halo;
}

static void free_scene(scene_of_all* s) {
  int p;
  rcbd_release(s->cuts);
  rcbd_release(s->scene);
  for (p = 0; p < size; ++p) free(s->order[p]);
  free(s->x);
  free(s->seat);
  free(s->region_lo);
  free(s->region_hi);
}
