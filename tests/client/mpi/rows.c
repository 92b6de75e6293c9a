/* What rcbd/mpi.h does with rows, against what each process finds out by itself: it knows all particles of a scene, by
   seed. mpi_rows ENDPOINT SEED: random scenes. */
#include "scene.h"

enum { MOST = 2000 };

typedef struct ghost {
  int64_t id;
  double x[3];
} ghost;

static int by_id_and_place(const void* a, const void* b) {
  const ghost *l = a, *r = b;
  int k;
  if (l->id != r->id) return l->id < r->id ? -1 : 1;
  for (k = 0; k < 3; ++k)
    if (l->x[k] < r->x[k] || l->x[k] > r->x[k]) return l->x[k] < r->x[k] ? -1 : 1;
  return 0;
}

/* The copies that process `to` needs of a particle, whose owner is `from`: how many, and where (NULL: anywhere). */
static int64_t images(const scene_of_all* s, int64_t id, int from, int to, ghost* at) {
  int64_t found = 0;
  int k[3], a, part;
  for (k[0] = -3; k[0] <= 3; ++k[0])
    for (k[1] = -3; k[1] <= 3; ++k[1])
      for (k[2] = -3; k[2] <= 3; ++k[2]) {
        ghost one = {id, {0, 0, 0}};
        int moved = 0, near = 0, possible = 1;
        for (a = 0; a < 3; ++a) {
          if (k[a] != 0) moved = 1;
          if (k[a] != 0 && (a >= s->dims || s->hi[a] == INFINITY)) possible = 0;
          if (a < s->dims) one.x[a] = s->x[id * s->dims + a];
          if (k[a] != 0 && possible) one.x[a] += k[a] * (s->hi[a] - s->lo[a]);
        }
        if (!possible || (!moved && from == to)) continue;
        for (part = s->parts * to / size; part < s->parts * (to + 1) / size && !near; ++part) {
          near = 1;
          for (a = 0; a < s->dims; ++a) {
            double lo = s->region_lo[part * s->dims + a], hi = s->region_hi[part * s->dims + a];
            if (lo > hi) near = 0;
            if (s->hi[a] < INFINITY && lo == -INFINITY) lo = s->lo[a];
            if (s->hi[a] < INFINITY && hi == INFINITY) hi = s->hi[a];
            if (lo - one.x[a] > s->width || one.x[a] - hi > s->width) near = 0;
          }
        }
        if (near && at != NULL) at[found] = one;
        found += near;
      }
  return found;
}

/* Rows that stay keep their order, those that come follow by process and row: order[p] lists the ids of process p. */
static void check_moves(const scene_of_all* s, rcbd_result* result) {
  rcbd_mpi_moves* moves;
  int64_t k, room, *id, before = s->count[rank], *expected = calloc((size_t)s->n + 1, 8), n = 0;
  int32_t* tag;
  float* pair;
  int p, q;
  for (q = 0; q < size; ++q) {
    p = q == 0 ? rank : q <= rank ? q - 1 : q; /* mine first */
    for (k = 0; k < s->count[p]; ++k)
      if (s->seat[s->order[p][k]] == rank) expected[n++] = s->order[p][k];
  }
  well(rcbd_mpi_moves_new(MPI_COMM_WORLD, result, before, &moves));
  rcbd_release(result);
  ensure(moves->before == before && moves->rows == n, "numbers of rows");
  room = n > before ? n : before;
  id = calloc((size_t)room + 1, 8);
  tag = calloc((size_t)room + 1, 4);
  pair = calloc((size_t)room + 1, 8);
  for (k = 0; k < before; ++k) {
    id[k] = s->order[rank][k];
    tag[k] = (int32_t)(7 * id[k]);
    pair[2 * k] = (float)id[k];
    pair[2 * k + 1] = -(float)id[k];
  }
  {
    const rcbd_mpi_field first[] = {{tag, room, MPI_INT32_T, 1, 0}, {id, room, MPI_INT64_T, 1, 0}};
    const rcbd_mpi_field second = {pair, room, MPI_FLOAT, 2, 0};
    well(rcbd_mpi_move(moves, first, 2));
    well(rcbd_mpi_move(moves, &second, 1));
  }
  for (k = 0; k < n; ++k)
    ensure(
        id[k] == expected[k] && tag[k] == 7 * id[k] && pair[2 * k] == (float)id[k] && pair[2 * k + 1] == -(float)id[k],
        "a row that was moved");
  rcbd_mpi_moves_free(moves);
  free(expected);
  free(id);
  free(tag);
  free(pair);
}

static void check_forward(const scene_of_all* s, rcbd_mpi_halo* halo) {
  const int64_t rows = halo->rows, all = rows + halo->ghosts;
  ghost *expected = calloc(MOST, sizeof(ghost)), *found = calloc((size_t)all + 1, sizeof(ghost)), at[343];
  int64_t *id = calloc((size_t)all + 1, 8), k, n = 0, c;
  double *x = calloc((size_t)all + 1, 24), *axis[3];
  float* single = calloc((size_t)all + 1, 12);
  char* name = calloc((size_t)all + 1, 5);
  rcbd_mpi_field fields[7] = {{id, all, MPI_INT64_T, 1, 0},
                              {x, all, MPI_DOUBLE, s->dims, 1},
                              {name, all, MPI_CHAR, 5, 0},
                              {single, all, MPI_FLOAT, s->dims, 1}};
  int p, a;
  for (a = 0; a < s->dims; ++a) {
    axis[a] = calloc((size_t)all + 1, 8);
    fields[4 + a].data = axis[a];
    fields[4 + a].room = all;
    fields[4 + a].type = MPI_DOUBLE;
    fields[4 + a].columns = 1;
    fields[4 + a].positions = 1 + a;
  }
  for (k = 0; k < rows; ++k) {
    id[k] = s->order[rank][k];
    snprintf(name + 5 * k, 5, "%d", (int)id[k]);
    for (a = 0; a < s->dims; ++a) {
      x[k * s->dims + a] = axis[a][k] = s->x[id[k] * s->dims + a];
      single[k * s->dims + a] = (float)x[k * s->dims + a];
    }
  }
  for (p = 0; p < size; ++p)
    for (k = 0; k < s->count[p]; ++k) {
      const int64_t more = images(s, s->order[p][k], p, rank, at);
      ensure(n + more <= MOST, "too many ghosts for this test");
      for (c = 0; c < more; ++c) expected[n++] = at[c];
    }
  ensure(n == halo->ghosts, "the number of ghosts");
  well(rcbd_mpi_forward(halo, rows, fields, 4 + s->dims));
  for (k = 0; k < n; ++k) {
    char text[5];
    ensure(id[rows + k] == expected[k].id, "a ghost's place in the order");
    snprintf(text, 5, "%d", (int)expected[k].id);
    ensure(strcmp(text, name + 5 * (rows + k)) == 0, "a ghost's name");
    found[k].id = id[rows + k];
    for (a = 0; a < s->dims; ++a) {
      const double real = s->x[found[k].id * s->dims + a], now = x[(rows + k) * s->dims + a];
      found[k].x[a] = now;
      ensure(axis[a][rows + k] == now, "an array an axis");
      ensure(single[(rows + k) * s->dims + a] ==
                 (now == real ? (float)real
                              : (float)((double)(float)real +
                                        round((now - real) / (s->hi[a] - s->lo[a])) * (s->hi[a] - s->lo[a]))),
             "positions of floats");
    }
  }
  qsort(expected, (size_t)n, sizeof(ghost), by_id_and_place);
  qsort(found, (size_t)n, sizeof(ghost), by_id_and_place);
  for (k = 0; k < n; ++k) ensure(memcmp(&found[k], &expected[k], sizeof(ghost)) == 0, "a ghost's position");
  for (a = 0; a < s->dims; ++a) free(axis[a]);
  free(expected);
  free(found);
  free(id);
  free(x);
  free(single);
  free(name);
}

/* What process `at` adds to a particle. */
static double share(int64_t id, int at) { return 1e-3 * (double)(id + 1) * (at + 1) + 1e10 * (at % 2); }

#define CHECK_SUMS(T, U, TYPE)                                                                                     \
  do {                                                                                                             \
    T* sum = calloc((size_t)all + 1, 2 * sizeof(T));                                                               \
    const rcbd_mpi_field field = {sum, all, TYPE, 2, 0};                                                           \
    for (k = 0; k < all; ++k) sum[2 * k + 1] = (T)((U)2 * (U)(sum[2 * k] = (T)share(id[k], rank)));                \
    well(rcbd_mpi_reverse_add(halo, rows, &field));                                                                \
    for (k = 0; k < all; ++k) {                                                                                    \
      T expected = (T)share(id[k], rank);                                                                          \
      for (p = 0; p < size && k < rows; ++p)                                                                       \
        for (c = images(s, id[k], rank, p, NULL); c > 0; --c) expected = (T)((U)expected + (U)(T)share(id[k], p)); \
      ensure(sum[2 * k] == expected && (TYPE == MPI_FLOAT || sum[2 * k + 1] == (T)((U)2 * (U)expected)),           \
             "a sum of " #T);                                                                                      \
    }                                                                                                              \
    free(sum);                                                                                                     \
  } while (0)

static void check_reverse(const scene_of_all* s, rcbd_mpi_halo* halo) {
  const int64_t rows = halo->rows, all = rows + halo->ghosts;
  int64_t *id = calloc((size_t)all + 1, 8), k, c;
  const rcbd_mpi_field ids = {id, all, MPI_INT64_T, 1, 0};
  int p;
  for (k = 0; k < rows; ++k) id[k] = s->order[rank][k];
  well(rcbd_mpi_forward(halo, rows, &ids, 1));
  CHECK_SUMS(double, double, MPI_DOUBLE);
  CHECK_SUMS(float, float, MPI_FLOAT);
  CHECK_SUMS(int64_t, uint64_t, MPI_INT64_T);
  CHECK_SUMS(int32_t, uint32_t, MPI_INT32_T);
  free(id);
}

static void a_scene(rcbd_client* client, unsigned seed) {
  scene_of_all s;
  rcbd_result* result;
  rcbd_mpi_halo* halo;
  make_scene(&s, client, seed);
  result = step_scene(&s);
  look_up(&s);
  check_moves(&s, result);
  take_over(&s);
  halo = make_halo(&s);
  check_forward(&s, halo);
  check_forward(&s, halo);
  check_reverse(&s, halo);
  rcbd_mpi_halo_free(halo);
  free_scene(&s);
}

int main(int count, char** word) {
  rcbd_client* client = NULL;
  unsigned seed, first;
  begin(&count, &word);
  first = (unsigned)atoi(word[2]);
  well(rcbd_mpi_connect(MPI_COMM_WORLD, word[1], NULL, &client));
  for (seed = first; seed < first + 12; ++seed) a_scene(client, seed);
  rcbd_release(client);
  MPI_Finalize();
  return 0;
}
