/* dem_c: soft spheres in a periodic box, on the processes of mpirun. A process computes the spheres of its own parts;
   of the others' it has copies of those that may touch them, the ghosts. At the start spheres fill half of the box, in
   two layers that flow past each other.

     mpicc -O2 -ffp-contract=off dem.c -o dem_c -lrcbd -lm

   The spheres move the same on any number of processes, to the bit: a contact is computed once, by the process that has
   the sphere of the lower id, by + - * / and sqrt alone, which must not be contracted, and forces are summed as
   integers. The cuts are the same, too, with the same --parts (default: the number of processes). */
#include <inttypes.h>
#include <math.h>
#include <rcbd/mpi.h>

/* ---- the solver, which knows nothing of processes ---- */

#define D 1.0         /* diameter; the mass is 1 */
#define K 1000.0      /* stiffness of a contact */
#define C 2.0         /* its damping */
#define DT 0.005      /* a contact lasts for 14 of these */
#define U 4294967296. /* an integer force of 1 is this part of a unit */

static struct {
  int64_t n, ghosts, room; /* the ghosts' rows follow mine */
  double *x, *v, *x0;      /* [room][3]; x0: where they were at the last push */
  int64_t *f, *id;         /* [room][3]: forces; [room] */
} s;

static void* resized(void* memory, int64_t count) {
  memory = realloc(memory, (size_t)count * 8);
  if (memory == NULL) abort();
  return memory;
}

static void make_room(int64_t rows) {
  if (rows <= s.room) return;
  s.room = rows + rows / 2;
  s.x = resized(s.x, 3 * s.room);
  s.v = resized(s.v, 3 * s.room);
  s.x0 = resized(s.x0, 3 * s.room);
  s.f = resized(s.f, 3 * s.room);
  s.id = resized(s.id, s.room);
}

/* Adds the sphere of this id, on a lattice with so many sites along an axis. */
static void place(int64_t id, int64_t sites) {
  const int64_t site[3] = {id / (sites * sites), id / sites % sites, id % sites};
  int64_t random = (id + 1) * 69621 % 2147483647;
  double u[6], *x = s.x + 3 * s.n, *v = s.v + 3 * s.n;
  int k;
  for (k = -3; k < 6; ++k) { /* the first three are thrown away */
    random = random * 16807 % 2147483647;
    if (k >= 0) u[k] = (double)random / 2147483647.0;
  }
  for (k = 0; k < 3; ++k) {
    x[k] = 1.2 * ((double)site[k] + (0.4 + 0.2 * u[k]));
    v[k] = 2 * u[3 + k] - 1;
  }
  v[0] += site[1] < sites / 2 ? 1 : -1;
  s.id[s.n++] = id;
}

/* The forces of i and j, whose id is the higher one. */
static void touch(int64_t i, int64_t j) {
  const double *xi = s.x + 3 * i, *xj = s.x + 3 * j, *vi = s.v + 3 * i, *vj = s.v + 3 * j;
  const double d[3] = {xj[0] - xi[0], xj[1] - xi[1], xj[2] - xi[2]};
  const double q = (d[0] * d[0] + d[1] * d[1]) + d[2] * d[2], r = sqrt(q);
  double closing, g;
  int k;
  if (q >= D * D || q == 0) return;
  closing = ((vi[0] - vj[0]) * d[0] + (vi[1] - vj[1]) * d[1]) + (vi[2] - vj[2]) * d[2];
  g = (K * (D - r) + C * closing / r) / r;
  for (k = 0; k < 3; ++k) {
    const int64_t force = (int64_t)floor(g * d[k] * U + 0.5);
    s.f[3 * j + k] += force;
    s.f[3 * i + k] -= force;
  }
}

/* Forces of all spheres and ghosts. What touches is in cells next to each other, as these are somewhat wider than D. */
static void forces(void) {
  const int64_t all = s.n + s.ghosts;
  double lo[3] = {0, 0, 0}, hi[3] = {0, 0, 0};
  int64_t cells[3], at[3], i, j, k, *head, *next = resized(NULL, all + 1), *cell = resized(NULL, all + 1);
  for (i = 0; i < 3 * all; ++i) {
    s.f[i] = 0;
    if (i < 3 || s.x[i] < lo[i % 3]) lo[i % 3] = s.x[i];
    if (i < 3 || s.x[i] > hi[i % 3]) hi[i % 3] = s.x[i];
  }
  for (k = 0; k < 3; ++k) cells[k] = (int64_t)((hi[k] - lo[k]) / (1.01 * D)) + 3; /* an empty one at each end */
  head = resized(NULL, cells[0] * cells[1] * cells[2]);
  for (i = 0; i < cells[0] * cells[1] * cells[2]; ++i) head[i] = -1;
  for (i = 0; i < all; ++i) {
    for (k = 0; k < 3; ++k) at[k] = (int64_t)((s.x[3 * i + k] - lo[k]) / (1.01 * D)) + 1;
    cell[i] = (at[0] * cells[1] + at[1]) * cells[2] + at[2];
    next[i] = head[cell[i]];
    head[cell[i]] = i;
  }
  for (i = 0; i < s.n; ++i)
    for (k = 0; k < 27; ++k)
      for (j = head[cell[i] + ((k / 9 - 1) * cells[1] + k / 3 % 3 - 1) * cells[2] + k % 3 - 1]; j >= 0; j = next[j])
        if (s.id[i] < s.id[j]) touch(i, j);
  free(head);
  free(next);
  free(cell);
}

static void advance(void) {
  int64_t k;
  for (k = 0; k < 3 * s.n; ++k) {
    s.v[k] += DT * ((double)s.f[k] / U);
    s.x[k] += DT * s.v[k];
  }
}

/* ---- the coupling ---- */

enum { PARTICLES, PUSHES, PUSH_EVERY, PARTS, REACH, NUMBERS, SCENE = NUMBERS, ENDPOINT, TRAJECTORY, OPTIONS };
static const char* const names[] = {"--particles", "--pushes", "--push-every", "--parts",
                                    "--reach",     "--scene",  "--endpoint",   "--trajectory"};
static double number[NUMBERS] = {500, 50, 10, 0, 0};
static const char* text[OPTIONS] = {NULL, NULL, NULL, NULL, NULL, "spheres", NULL, NULL};
static const char* positions = "every-step";
static MPI_Comm comm;
static int rank, size;

/* Of all processes together. */
static void end(const char* message, const char* hint) {
  if (rank == 0) fprintf(stderr, "dem_c: %s; %s\n", message, hint);
  MPI_Finalize();
  exit(1);
}

static void all_must(int code) {
  if (code != RCBD_OK) end(rcbd_mpi_message(), rcbd_mpi_hint());
}

/* What may fail here alone. */
static void must(int code) {
  if (code == RCBD_OK) return;
  fprintf(stderr, "dem_c: %s; %s\n", rcbd_mpi_message(), rcbd_mpi_hint());
  MPI_Abort(comm, 1);
}

static rcbd_mpi_field field(void* data, MPI_Datatype type, int32_t columns) {
  const rcbd_mpi_field one = {data, s.room, type, columns, data == s.x};
  return one;
}

/* Pushes my spheres and hands over those that leave. Returns whether there are new cuts. */
static int push(rcbd_scene* scene, const double* lo, const double* hi) {
  const rcbd_positions x = rcbd_rows(s.x, s.n, 3);
  const int wrapped = rcbd_wrap(&x, lo, hi);
  all_must(rcbd_mpi_agree(comm, wrapped, rcbd_message(), rcbd_hint()));
  rcbd_step_options step = RCBD_STEP_OPTIONS;
  rcbd_report report = RCBD_REPORT;
  rcbd_result* result;
  rcbd_mpi_moves* moves;
  step.ids = s.id;
  all_must(rcbd_mpi_step(comm, scene, &x, &step, &result));
  all_must(rcbd_mpi_moves_new(comm, result, s.n, &moves));
  make_room(moves->rows);
  const rcbd_mpi_field fields[] = {field(s.id, MPI_INT64_T, 1), field(s.x, MPI_DOUBLE, 3), field(s.v, MPI_DOUBLE, 3)};
  must(rcbd_mpi_move(moves, fields, 3));
  s.n = moves->rows;
  memcpy(s.x0, s.x, (size_t)s.n * 3 * sizeof(double));
  rcbd_mpi_moves_free(moves);
  rcbd_result_report(result, &report);
  rcbd_release(result);
  return report.repartitioned;
}

/* The halo until the next push. A sphere of another process and one of mine may both move by the reach until then,
   towards each other. The millionth more is for what is lost in rounding. */
static rcbd_mpi_halo* make_halo(rcbd_scene* scene, const double* lo, const double* hi, rcbd_cuts_info* info) {
  const rcbd_positions x = rcbd_rows(s.x, s.n, 3);
  const rcbd_near near = {sizeof(rcbd_near), 1.000001 * (D + 2 * number[REACH]), lo, hi, RCBD_MAX, 0};
  rcbd_ask_options ask = RCBD_ASK_OPTIONS;
  rcbd_cuts* cuts;
  rcbd_mpi_halo* halo;
  ask.ids = s.id;
  rcbd_scene_cuts(scene, &cuts); /* NULL where it fails */
  all_must(rcbd_mpi_halo_new(comm, cuts, &x, &near, &ask, &halo));
  rcbd_cuts_describe(cuts, info);
  rcbd_release(cuts);
  s.ghosts = halo->ghosts;
  make_room(s.n + s.ghosts);
  const rcbd_mpi_field id = field(s.id, MPI_INT64_T, 1);
  must(rcbd_mpi_forward(halo, s.n, &id, 1));
  return halo;
}

static void check_reach(void) {
  char message[200];
  int64_t far = INT64_MAX, k;
  for (k = 0; k < 3 * s.n; ++k)
    if (!(fabs(s.x[k] - s.x0[k]) <= number[REACH]) && s.id[k / 3] < far) far = s.id[k / 3];
  MPI_Allreduce(MPI_IN_PLACE, &far, 1, MPI_INT64_T, MPI_MIN, comm);
  if (far == INT64_MAX) return;
  snprintf(message, sizeof(message),
           "sphere %ld has moved by more than %g since the last push, so the halo may lack spheres that it touches",
           (long)far, number[REACH]);
  end(message, "push more often (--push-every), or give a greater --reach");
}

static void move_until_next_push(rcbd_mpi_halo* halo) {
  const rcbd_mpi_field fields[] = {field(s.x, MPI_DOUBLE, 3), field(s.v, MPI_DOUBLE, 3)};
  const rcbd_mpi_field force = field(s.f, MPI_INT64_T, 3);
  int64_t step;
  for (step = 0; step < (int64_t)number[PUSH_EVERY]; ++step) {
    if (step > 0) check_reach();
    must(rcbd_mpi_forward(halo, s.n, fields, 2));
    forces();
    must(rcbd_mpi_reverse_add(halo, s.n, &force));
    advance();
  }
}

/* Of doubles [pushes][particles][3] those of my spheres, after so many others. */
static void write_trajectory(int64_t before) {
  FILE* file = fopen(text[TRAJECTORY], "r+b");
  int64_t i;
  int well = file != NULL && setvbuf(file, NULL, _IONBF, 0) == 0;
  for (i = 0; i < s.n && well; ++i)
    well = fseek(file, (long)(24 * (before + s.id[i])), SEEK_SET) == 0 && fwrite(s.x + 3 * i, 24, 1, file) == 1;
  if (file != NULL && fclose(file) != 0) well = 0;
  all_must(rcbd_mpi_agree(comm, well ? RCBD_OK : RCBD_IO_ERROR, "the trajectory can't be written", text[TRAJECTORY]));
}

/* ---- the program ---- */

static void usage(FILE* to, int code) {
  fprintf(to,
          "dem_c: soft spheres in a periodic box, on the processes of mpirun\n"
          "    [--particles N] [--pushes N] [--push-every TIME_STEPS] [--parts N] [--reach R] [--when-needed]\n"
          "    [--scene NAME] [--endpoint E] [--trajectory FILE] [--help]\n");
  exit(code);
}

static void read_options(int count, char** word) {
  int k, o;
  for (k = 1; k < count; ++k) {
    char* stop = NULL;
    if (strcmp(word[k], "--help") == 0) usage(stdout, 0);
    if (strcmp(word[k], "--when-needed") == 0) {
      positions = "when-needed";
      continue;
    }
    for (o = 0; o < OPTIONS && strcmp(word[k], names[o]) != 0;) ++o;
    if (o < OPTIONS && k + 1 < count) text[o] = stop = word[++k];
    if (o < NUMBERS && stop != NULL) {
      number[o] = strtod(text[o], &stop);
      if (*stop || !(number[o] >= (o == PARTS ? 0 : 1e-9) && number[o] < 1e9)) stop = NULL;
      if (o != REACH && number[o] != floor(number[o])) stop = NULL;
    }
    if (stop == NULL || *text[o] == '\0') {
      fprintf(stderr, "dem_c: %s: a wrong option or value\n", word[k]);
      usage(stderr, 2);
    }
  }
  if (number[REACH] == 0) number[REACH] = 6 * DT * number[PUSH_EVERY]; /* the fastest begin with 2 along an axis */
}

int main(int count, char** word) {
  read_options(count, word);
  MPI_Init(&count, &word);
  MPI_Comm_dup(MPI_COMM_WORLD, &comm);
  MPI_Comm_rank(comm, &rank);
  MPI_Comm_size(comm, &size);
  const int64_t particles = (int64_t)number[PARTICLES], pushes = (int64_t)number[PUSHES];
  int64_t sites = 4, repartitioned = 0, k;
  while (sites * sites * sites < 2 * particles) ++sites;
  const double side = 1.2 * (double)sites, lo[3] = {0, 0, 0}, hi[3] = {side, side, side};
  if (!(2 * 1.000001 * (D + 2 * number[REACH]) < side))
    end("the halo is as wide as half of the box, so a sphere could meet two images of another",
        "take a smaller --reach or --push-every, or more --particles");
  rcbd_scene_options options = RCBD_SCENE_OPTIONS;
  rcbd_client* client;
  rcbd_scene* scene;
  rcbd_cuts_info info = RCBD_CUTS_INFO;
  options.parts = number[PARTS] > 0 ? (int32_t)number[PARTS] : size;
  options.tolerance = 0.05;
  options.positions = positions;
  options.replace = 1;
  all_must(rcbd_mpi_connect(comm, text[ENDPOINT], NULL, &client));
  all_must(rcbd_mpi_scene_open(comm, client, text[SCENE], &options, &scene));
  if (rank == 0 && text[TRAJECTORY]) { /* empty, before the first push ends */
    FILE* file = fopen(text[TRAJECTORY], "wb");
    if (file != NULL) fclose(file);
  }
  make_room(particles / size + 1);
  for (k = particles * rank / size; k < particles * (rank + 1) / size; ++k) place(k, sites);
  for (k = 0; k < pushes; ++k) {
    repartitioned += push(scene, lo, hi);
    if (text[TRAJECTORY]) write_trajectory(k * particles);
    rcbd_mpi_halo* halo = make_halo(scene, lo, hi, &info);
    move_until_next_push(halo);
    rcbd_mpi_halo_free(halo);
  }
  if (rank == 0)
    printf("pushes %" PRId64 "\nrepartitioned %" PRId64 "\ncuts %016" PRIx64 "\n", pushes, repartitioned, info.hash);
  rcbd_release(scene);
  rcbd_release(client);
  MPI_Finalize();
  return 0;
}
