/* One of `seats` processes that step a trajectory by the C interface: c_history ENDPOINT SCENE FILE N DIMS STEPS PARTS
   POSITIONS SEAT SEATS. FILE: doubles, [STEPS][N][DIMS]. Seat 0 makes the scene anew and says "made" once it is there;
   the others are to be started then. Each begins with every SEATS-th particle. Since all know the whole trajectory,
   none has to be told which particles come to it: the cuts say so. Each prints, for each step, what all must agree on.
 */
#include <inttypes.h>
#include <rcbd/rcbd.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static void must(int code) {
  if (code == RCBD_OK) return;
  fprintf(stderr, "%s: %s; %s\n", rcbd_code_name(code), rcbd_message(), rcbd_hint());
  exit(1);
}

static void ensure(int right, const char* what) {
  if (right) return;
  fprintf(stderr, "%s\n", what);
  exit(1);
}

static void* room(size_t bytes) {
  void* memory = malloc(bytes > 0 ? bytes : 1);
  ensure(memory != NULL, "no memory");
  return memory;
}

struct solver {
  int64_t n, dims, steps, seat, seats, parts;
  double* all;   /* [steps][n][dims] */
  double* xyz;   /* [n][dims]: mine, first */
  int64_t* ids;  /* [n] */
  int32_t* part; /* [n], of all */
  int64_t mine;
};

static void gather(struct solver* s, int64_t step) {
  int64_t k;
  for (k = 0; k < s->mine; ++k)
    memcpy(s->xyz + k * s->dims, s->all + (step * s->n + s->ids[k]) * s->dims, (size_t)s->dims * sizeof(double));
}

/* Takes over the particles of my parts, and checks that `leaving` names those that were mine and are no more. */
static void hand_over(struct solver* s, rcbd_cuts* cuts, rcbd_result* result, int64_t step) {
  const rcbd_positions positions = rcbd_rows(s->all + step * s->n * s->dims, s->n, (int32_t)s->dims);
  const int64_t* row;
  const int32_t* seat;
  int64_t leaving, k, id, left = 0;
  must(rcbd_cuts_owner(cuts, &positions, NULL, s->part));
  must(rcbd_result_leaving(result, &row, &seat, &leaving));
  for (k = 0; k < s->mine; ++k) {
    const int32_t to = (int32_t)((((int64_t)s->part[s->ids[k]] + 1) * s->seats - 1) / s->parts);
    if (to == s->seat) continue;
    ensure(left < leaving && row[left] == k && seat[left] == to,
           "a row leaves that was not named, or for another seat");
    ++left;
  }
  ensure(left == leaving, "more rows are named than leave");
  s->mine = 0;
  for (id = 0; id < s->n; ++id)
    if ((((int64_t)s->part[id] + 1) * s->seats - 1) / s->parts == s->seat) s->ids[s->mine++] = id;
}

static void print_step(const rcbd_report* report, rcbd_cuts* cuts) {
  rcbd_cuts_info info = RCBD_CUTS_INFO;
  must(rcbd_cuts_describe(cuts, &info));
  ensure(info.epoch == report->epoch, "cuts of another epoch than the report's");
  printf("%" PRId64 " %" PRId64 " %d %.17g %.17g %.17g %d %" PRId64 " %" PRId64 " %d %016" PRIx64 " %d\n", report->step,
         report->n, report->parts, report->error_before, report->error, report->imbalance, report->repartitioned,
         report->epoch, report->moved, report->axes_flipped, info.hash, report->sent);
}

static rcbd_scene* open_scene(rcbd_client* client, char** arguments, const struct solver* s) {
  rcbd_scene_options options = RCBD_SCENE_OPTIONS;
  rcbd_scene* scene;
  options.parts = (int32_t)s->parts;
  options.dims = (int32_t)s->dims;
  options.positions = arguments[8];
  options.seat = (int32_t)s->seat;
  options.seats = (int32_t)s->seats;
  options.replace = 1;
  must(rcbd_scene_open(client, arguments[2], &options, &scene));
  puts("made");
  fflush(stdout);
  return scene;
}

int main(int count, char** arguments) {
  struct solver s;
  rcbd_client* client;
  rcbd_scene* scene;
  FILE* file;
  int64_t step, id;
  ensure(count == 11, "wrong arguments");
  s.n = atoll(arguments[4]);
  s.dims = atoll(arguments[5]);
  s.steps = atoll(arguments[6]);
  s.parts = atoll(arguments[7]);
  s.seat = atoll(arguments[9]);
  s.seats = atoll(arguments[10]);
  s.all = room((size_t)(s.steps * s.n * s.dims) * sizeof(double));
  s.xyz = room((size_t)(s.n * s.dims) * sizeof(double));
  s.ids = room((size_t)s.n * sizeof(int64_t));
  s.part = room((size_t)s.n * sizeof(int32_t));
  file = fopen(arguments[3], "rb");
  ensure(file != NULL &&
             fread(s.all, sizeof(double), (size_t)(s.steps * s.n * s.dims), file) == (size_t)(s.steps * s.n * s.dims),
         "the file is too short");
  fclose(file);
  s.mine = 0;
  for (id = s.seat; id < s.n; id += s.seats) s.ids[s.mine++] = id;
  must(rcbd_connect(arguments[1], NULL, &client));
  scene = open_scene(client, arguments, &s);
  for (step = 0; step < s.steps; ++step) {
    rcbd_report report = RCBD_REPORT;
    rcbd_step_options options = RCBD_STEP_OPTIONS;
    rcbd_positions positions;
    rcbd_result* result;
    rcbd_cuts* cuts;
    gather(&s, step);
    positions = rcbd_rows(s.xyz, s.mine, (int32_t)s.dims);
    options.ids = s.ids;
    options.send = step == s.steps - 1;
    must(rcbd_step(scene, &positions, &options, &result));
    must(rcbd_result_report(result, &report));
    must(rcbd_scene_cuts(scene, &cuts));
    print_step(&report, cuts);
    hand_over(&s, cuts, result, step);
    rcbd_release(cuts);
    rcbd_release(result);
  }
  rcbd_release(scene);
  rcbd_release(client);
  free(s.all);
  free(s.xyz);
  free(s.ids);
  free(s.part);
  return 0;
}
