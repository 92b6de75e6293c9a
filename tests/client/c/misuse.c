/* What a C program may do wrong, and what questions about cuts answer: each case is a message in words, or the right
 * answer. */
#include <stddef.h>

#include "expect.h"

static void nulls(void) {
  const rcbd_positions positions = all();
  rcbd_client* client = (rcbd_client*)&positions;
  rcbd_scene* scene = (rcbd_scene*)&positions;
  rcbd_lists* lists;
  rcbd_cuts* cuts;
  rcbd_op* op;
  rcbd_arrays* arrays;
  rcbd_positions to = RCBD_POSITIONS;
  double box[3] = {0, 0, 0};
  int64_t count;
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_connect(endpoint, NULL, NULL));
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_scene_open(NULL, "a", NULL, &scene));
  EXPECT(scene == NULL);
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_scene_drop(NULL, "a"));
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_last_step(NULL, &count));
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_step(NULL, &positions, NULL, NULL));
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_step_begin(NULL, &positions, NULL, &op));
  EXPECT(op == NULL);
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_wait(NULL, 1, NULL));
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_arrays_new(NULL, 1, RCBD_ROWS, 0, &arrays));
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_arrays_positions(NULL, &to));
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_result_report(NULL, NULL));
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_result_parts(NULL, NULL, NULL));
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_result_changed(NULL, NULL, NULL, NULL));
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_result_leaving(NULL, NULL, NULL, NULL));
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_scene_cuts(NULL, &cuts));
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_cuts_describe(NULL, NULL));
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_cuts_regions(NULL, box, box));
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_cuts_owner(NULL, &positions, NULL, NULL));
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_cuts_halo(NULL, &positions, NULL, NULL, &lists));
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_cuts_neighbours(NULL, 0, NULL, &lists));
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_cuts_box(NULL, box, box, NULL, &lists));
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_cuts_narrowest(NULL, NULL, NULL, NULL, NULL));
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_lists_read(NULL, NULL));
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_wrap(NULL, box, box));
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_close(NULL));
  EXPECT(rcbd_retain(NULL) == NULL && rcbd_notice(NULL) == NULL);
  rcbd_release(NULL);
  rcbd_interrupt(NULL);
  rcbd_cancel(NULL);
  client = connected();
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_close(NULL));
  EXPECT(rcbd_notice(client) == NULL && strstr(rcbd_message(), "NULL") != NULL); /* no notice is no failure */
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_scene_open(client, NULL, NULL, &scene));
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_scene_open(client, "a", NULL, NULL));
  scene = opened(client, "nulls");
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_step(scene, NULL, NULL, NULL));
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_step_begin(scene, &positions, NULL, NULL));
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_last_step(scene, NULL));
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_scene_cuts(scene, NULL));
  EXPECT_CODE(RCBD_NOT_FOUND, rcbd_scene_cuts(scene, &cuts));
  MUST(rcbd_step(scene, &positions, NULL, NULL));
  MUST(rcbd_scene_cuts(scene, &cuts));
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_cuts_owner(cuts, &positions, NULL, NULL));
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_cuts_halo(cuts, &positions, NULL, NULL, NULL));
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_cuts_box(cuts, NULL, box, NULL, &lists));
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_cuts_regions(cuts, box, NULL));
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_cuts_narrowest(cuts, NULL, NULL, NULL, NULL));
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_wrap(&positions, NULL, box));
  /* Handles of another kind, and pointers that are none. */
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_step((rcbd_scene*)client, &positions, NULL, NULL));
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_lists_read((rcbd_lists*)cuts, NULL));
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_close(cuts));
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_step((rcbd_scene*)xyz, &positions, NULL, NULL));
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_step((rcbd_scene*)((char*)xyz + 1), &positions, NULL, NULL));
  rcbd_release(xyz);
  EXPECT(rcbd_retain(xyz) == NULL && rcbd_retain(cuts) == cuts);
  rcbd_release(cuts);
  MUST(rcbd_cuts_regions(cuts, malloc(8 * 3 * sizeof(double)), malloc(8 * 3 * sizeof(double))));
  rcbd_release(cuts);
  rcbd_release(scene);
  rcbd_release(client);
}

static void shapes(void) {
  rcbd_client* client = connected();
  rcbd_scene* scene = opened(client, "shapes");
  rcbd_step_options options = RCBD_STEP_OPTIONS;
  rcbd_report report = RCBD_REPORT;
  rcbd_positions positions = rcbd_rows(xyz[0], N, 2);
  rcbd_result* result;
  struct {
    rcbd_step_options options;
    int64_t later;
  } newer = {RCBD_STEP_OPTIONS, 0};
  const rcbd_positions good = all();
  rcbd_cuts* cuts;
  rcbd_near near = RCBD_NEAR;
  rcbd_lists* lists;
  static int32_t part[N];
  const double lo[3] = {0, 0, 0}, hi[3] = {1, 0, 1};
  const int64_t* row;
  const int32_t* to;
  int64_t count;
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_step(scene, &positions, NULL, NULL));
  EXPECT(strstr(rcbd_message(), "2 dimensions") != NULL);
#define WRONG(field, value)  \
  positions = all();         \
  positions.field = (value); \
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_step(scene, &positions, NULL, NULL))
  WRONG(size, 0);
  WRONG(size, (size_t)-1);
  WRONG(count, -1);
  WRONG(stride, 0);
  WRONG(stride, -3);
  WRONG(dims, 0);
  WRONG(dims, 4);
  WRONG(single, 7);
  WRONG(axis[2], NULL);
  WRONG(count, (int64_t)1 << 60);
#define WRONG_OPTION(field, value)                                             \
  options.field = (value);                                                     \
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_step(scene, &good, &options, NULL)); \
  options = newer.options
  WRONG_OPTION(size, 0);
  WRONG_OPTION(inserted, -1);
  WRONG_OPTION(threads, 0);
  WRONG_OPTION(deadline_seconds, -1);
  WRONG_OPTION(deadline_seconds, NAN);
  WRONG_OPTION(step_seconds, NAN);
  WRONG_OPTION(step, -2);
  /* Options of a later version: refused if they are used, else taken. */
  newer.options.size = sizeof newer;
  newer.later = 1;
  EXPECT_CODE(RCBD_UNSUPPORTED, rcbd_step(scene, &good, &newer.options, NULL));
  newer.later = 0;
  MUST(rcbd_step(scene, &good, &newer.options, &result));
  /* A program with an older, shorter report. */
  report.size = offsetof(rcbd_report, n) + sizeof report.n;
  report.error = -5;
  MUST(rcbd_result_report(result, &report));
  EXPECT(report.n == N && report.error == -5 && report.size == offsetof(rcbd_report, n) + sizeof report.n);
  to = part;
  row = &count;
  count = 5;
  EXPECT_CODE(RCBD_NOT_FOUND, rcbd_result_parts(result, &to, &count));
  EXPECT(to == NULL && count == 0);
  to = part;
  count = 5;
  EXPECT_CODE(RCBD_NOT_FOUND, rcbd_result_changed(result, &row, &to, &count));
  EXPECT(row == NULL && to == NULL && count == 0);
  row = &count;
  to = part;
  count = 5;
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_result_leaving((rcbd_result*)scene, &row, &to, &count));
  EXPECT(row == NULL && to == NULL && count == 0);
  MUST(rcbd_result_leaving(result, &row, &to, &count));
  EXPECT(count == 0);
  rcbd_release(result);
  MUST(rcbd_scene_cuts(scene, &cuts));
  positions = rcbd_rows(xyz[0], N, 2);
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_cuts_owner(cuts, &positions, NULL, part));
  near.width = -1;
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_cuts_halo(cuts, &good, &near, NULL, &lists));
  near.width = NAN;
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_cuts_neighbours(cuts, 0, &near, &lists));
  near.width = 0.1;
  near.norm = 9;
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_cuts_halo(cuts, &good, &near, NULL, &lists));
  near.norm = RCBD_EUCLID;
  near.lo = lo;
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_cuts_halo(cuts, &good, &near, NULL, &lists));
  near.hi = hi;
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_cuts_halo(cuts, &good, &near, NULL, &lists));
  near.lo = near.hi = NULL;
  EXPECT_CODE(RCBD_NOT_FOUND, rcbd_cuts_neighbours(cuts, 8, &near, &lists));
  EXPECT_CODE(RCBD_NOT_FOUND, rcbd_cuts_neighbours(cuts, -1, &near, &lists));
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_wrap(&good, lo, hi));
  rcbd_release(cuts);
  rcbd_release(scene);
  rcbd_release(client);
}

/* Goes on with a scene that is there, unless it is another one. */
static void going_on(void) {
  rcbd_client* client = connected();
  rcbd_scene_options options = RCBD_SCENE_OPTIONS;
  const rcbd_positions positions = all();
  rcbd_scene* scene;
  int64_t step;
  EXPECT_CODE(RCBD_NOT_FOUND, rcbd_scene_open(client, "going-on", &options, &scene));
  options.parts = 4;
  MUST(rcbd_scene_open(client, "going-on", &options, &scene));
  MUST(rcbd_last_step(scene, &step));
  EXPECT(step == -1);
  MUST(rcbd_step(scene, &positions, NULL, NULL));
  rcbd_release(scene);
  MUST(rcbd_scene_open(client, "going-on", &options, &scene));
  MUST(rcbd_last_step(scene, &step));
  EXPECT(step == 0);
  rcbd_release(scene);
  options.tolerance = 0.2;
  EXPECT_CODE(RCBD_ALREADY_EXISTS, rcbd_scene_open(client, "going-on", &options, &scene));
  EXPECT(strstr(rcbd_message(), "tolerance is 0.1, not 0.2") != NULL);
  options.parts = 0;
  MUST(rcbd_scene_open(client, "going-on", &options, &scene));
  EXPECT_CODE(RCBD_OK, rcbd_close(scene));
  rcbd_release(scene);
  options.replace = 1;
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_scene_open(client, "going-on", &options, &scene));
  options.parts = 2;
  options.tolerance = INFINITY;
  MUST(rcbd_scene_open(client, "going-on", &options, &scene));
  rcbd_release(scene);
  options.replace = 0;
  MUST(rcbd_scene_open(client, "going-on", &options, &scene));
  rcbd_release(scene);
  MUST(rcbd_scene_drop(client, "going-on"));
  EXPECT_CODE(RCBD_NOT_FOUND, rcbd_scene_drop(client, "going-on"));
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_scene_open(client, "no name", &options, &scene));
  options.seat = 1;
  options.seats = 2;
  options.deadline_seconds = 0.2; /* nobody makes it */
  EXPECT_CODE(RCBD_NOT_FOUND, rcbd_scene_open(client, "going-on", &options, &scene));
  rcbd_release(client);
}

static void not_finite(void) {
  rcbd_client* client = connected();
  rcbd_scene* scene = opened(client, "nan");
  rcbd_step_options options = RCBD_STEP_OPTIONS;
  const rcbd_positions positions = all();
  const double lo[3] = {0, 0, 0}, hi[3] = {1, 1, 1};
  static double weights[N];
  static int32_t part[N];
  rcbd_cuts* cuts;
  rcbd_lists* lists;
  rcbd_near near = RCBD_NEAR;
  int i;
  MUST(rcbd_step(scene, &positions, NULL, NULL));
  MUST(rcbd_scene_cuts(scene, &cuts));
  xyz[17][1] = NAN;
  EXPECT_CODE(RCBD_NOT_FINITE, rcbd_step(scene, &positions, NULL, NULL));
  EXPECT(strstr(rcbd_message(), "17") != NULL);
  EXPECT_CODE(RCBD_NOT_FINITE, rcbd_cuts_owner(cuts, &positions, NULL, part));
  EXPECT_CODE(RCBD_NOT_FINITE, rcbd_cuts_halo(cuts, &positions, &near, NULL, &lists));
  EXPECT_CODE(RCBD_NOT_FINITE, rcbd_wrap(&positions, lo, hi));
  EXPECT(strstr(rcbd_message(), "17") != NULL);
  xyz[17][1] = 0.5;
  MUST(rcbd_step(scene, &positions, NULL, NULL));
  rcbd_release(cuts);
  rcbd_release(scene);
  scene = opened(client, "nan");
  for (i = 0; i < N; ++i) weights[i] = 1;
  weights[5] = -INFINITY;
  options.weights = weights;
  EXPECT(rcbd_step(scene, &positions, &options, NULL) > 0 && strstr(rcbd_message(), "5") != NULL);
  rcbd_release(scene);
  rcbd_release(client);
}

static void closed(void) {
  rcbd_client* client = connected();
  rcbd_scene *scene = opened(client, "closed"), *other = opened(client, "other");
  const rcbd_positions positions = all();
  rcbd_step_options options = RCBD_STEP_OPTIONS;
  rcbd_cuts_info info = RCBD_CUTS_INFO;
  rcbd_report report = RCBD_REPORT;
  rcbd_result* result;
  rcbd_cuts* cuts;
  rcbd_op* op;
  const int32_t* part;
  int64_t count;
  options.want_parts = 1;
  MUST(rcbd_step(scene, &positions, &options, &result));
  MUST(rcbd_scene_cuts(scene, &cuts));
  MUST(rcbd_close(scene));
  MUST(rcbd_close(scene));
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_step(scene, &positions, NULL, NULL));
  EXPECT(strstr(rcbd_message(), "'closed' was closed") != NULL);
  count = 5;
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_last_step(scene, &count));
  EXPECT(count == -1);
  MUST(rcbd_step_begin(scene, &positions, NULL, &op));
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_wait(op, -1, NULL));
  rcbd_release(op);
  MUST(rcbd_step(other, &positions, NULL, NULL));
  MUST(rcbd_close(client));
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_step(other, &positions, NULL, NULL));
  EXPECT(strstr(rcbd_message(), "client was closed") != NULL);
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_scene_drop(client, "other"));
  rcbd_release(client);
  rcbd_release(scene);
  rcbd_release(other);
  /* What was told stays. */
  MUST(rcbd_result_report(result, &report));
  MUST(rcbd_result_parts(result, &part, &count));
  MUST(rcbd_cuts_describe(cuts, &info));
  EXPECT(report.n == N && report.repartitioned == 1 && strlen(report.json) > 100 && count == N && info.parts == 8);
  EXPECT(isnan(report.error_before) && report.positions_step == 0 && part[0] >= 0 && part[0] < 8);
  rcbd_release(result);
  rcbd_release(cuts);
}

/* Arrays are touched after growth, steps, close and the end of everything. */
static void arrays(void) {
  rcbd_client* client = connected();
  rcbd_scene* scene = opened(client, "arrays");
  rcbd_arrays *small, *large, *floats;
  rcbd_positions at = RCBD_POSITIONS, more = RCBD_POSITIONS, single = RCBD_POSITIONS;
  rcbd_report report = RCBD_REPORT;
  rcbd_result* result;
  double* x;
  int64_t i;
  EXPECT_CODE(RCBD_TOO_LARGE, rcbd_arrays_new(scene, (int64_t)1 << 50, RCBD_ROWS, 0, &small));
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_arrays_new(scene, -1, RCBD_ROWS, 0, &small));
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_arrays_new(scene, 1, (rcbd_layout)5, 0, &small));
  MUST(rcbd_arrays_new(scene, N, RCBD_ROWS, 0, &small));
  MUST(rcbd_arrays_positions(small, &at));
  EXPECT(at.count == N && at.stride == 3 && at.dims == 3 && at.axis[2] == (double*)at.axis[0] + 2);
  memcpy(at.axis[0], xyz, sizeof xyz);
  MUST(rcbd_step(scene, &at, NULL, NULL));
  MUST(rcbd_arrays_new(scene, 40 * N, RCBD_ROWS, 0, &large));
  MUST(rcbd_arrays_positions(large, &more));
  EXPECT(more.axis[0] != at.axis[0] && memcmp(more.axis[0], xyz, sizeof xyz) == 0);
  for (x = at.axis[0], i = 0; i < 3 * N; ++i) x[i] *= 0.9; /* the old ones are still there */
  MUST(rcbd_step(scene, &at, NULL, NULL));
  more.count = N;
  MUST(rcbd_step(scene, &more, NULL, &result));
  MUST(rcbd_result_report(result, &report));
  EXPECT(report.n == N && report.step == 2);
  rcbd_release(result);
  MUST(rcbd_arrays_new(scene, 0, RCBD_AXES, 1, &floats));
  MUST(rcbd_arrays_positions(floats, &single));
  EXPECT(single.count == 0 && single.single == 1 && single.stride == 1 && single.dims == 3 && single.axis[1] != NULL);
  MUST(rcbd_close(client));
  rcbd_release(scene);
  rcbd_release(client);
  for (x = more.axis[0], i = 0; i < 3 * 40 * N; ++i) x[i] = 1;
  for (x = at.axis[0], i = 0; i < 3 * N; ++i) x[i] = 1;
  *(float*)single.axis[2] = 1;
  rcbd_release(small);
  rcbd_release(large);
  rcbd_release(floats);
}

static void no_service(void) {
  rcbd_client* client;
  rcbd_connect_options options = RCBD_CONNECT_OPTIONS;
  options.deadline_seconds = 0.2;
  EXPECT_CODE(RCBD_UNAVAILABLE, rcbd_connect("unix:/nonexistent/rcbd.sock", &options, &client));
  EXPECT(client == NULL && strstr(rcbd_message(), "/nonexistent") != NULL && strlen(rcbd_hint()) > 0);
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_connect("nowhere", &options, &client));
  options.path = "by post";
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_connect(endpoint, &options, &client));
  options.path = NULL;
  options.deadline_seconds = NAN;
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_connect(endpoint, &options, &client));
  EXPECT(rcbd_version() == RCBD_VERSION);
  EXPECT(strcmp(rcbd_code_name(20), "not_conserved") == 0 && strcmp(rcbd_code_name(65538), "internal") == 0);
}

/* Waiting for this process' own other client would be in vain: the default deadline is 60 s. */
static void held_here(void) {
  rcbd_client *client = connected(), *other = connected();
  rcbd_scene* scene = opened(client, "held");
  rcbd_scene_options options = RCBD_SCENE_OPTIONS;
  rcbd_scene* none;
  options.parts = 8;
  options.replace = 1;
  EXPECT_CODE(RCBD_BUSY, rcbd_scene_open(other, "held", &options, &none));
  EXPECT(strstr(rcbd_message(), "librcbd (pid ") != NULL && strstr(rcbd_hint(), "this process") != NULL);
  EXPECT(rcbd_notice(other) == NULL);
  EXPECT_CODE(RCBD_BUSY, rcbd_scene_drop(other, "held"));
  EXPECT(rcbd_notice(other) == NULL);
  rcbd_release(scene);
  MUST(rcbd_scene_drop(other, "held"));
  rcbd_release(client);
  rcbd_release(other);
}

int main(int count, char** arguments) {
  static const struct test_case cases[] = {{"held_here", held_here}, {"nulls", nulls},           {"shapes", shapes},
                                           {"going_on", going_on},   {"not_finite", not_finite}, {"closed", closed},
                                           {"arrays", arrays},       {"no_service", no_service}};
  return run_case(count, arguments, cases, sizeof cases / sizeof cases[0]);
}
