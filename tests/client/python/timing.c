/* What a count step, a question to whom positions belong, and a halo take from C: python_timing ENDPOINT N REPEATS WANT.
   Prints three medians in microseconds. tests/client/python/timing.py does the same from Python, and compares. */
#define _POSIX_C_SOURCE 200809L
#include <rcbd/rcbd.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

static void must(int code) {
  if (code == RCBD_OK) return;
  fprintf(stderr, "%s; %s\n", rcbd_message(), rcbd_hint());
  exit(1);
}

static double now(void) {
  struct timespec time;
  clock_gettime(CLOCK_MONOTONIC, &time);
  return (double)time.tv_sec * 1e6 + (double)time.tv_nsec * 1e-3;
}

static int ascending(const void* one, const void* other) {
  const double a = *(const double*)one, b = *(const double*)other;
  return (a > b) - (a < b);
}

static void print_median(double* seconds, int count) {
  qsort(seconds, (size_t)count, sizeof(double), ascending);
  printf("%.3f\n", seconds[count / 2]);
}

int main(int count, char** words) {
  const int64_t n = count == 5 ? atoll(words[2]) : 0;
  const int repeats = count == 5 ? atoi(words[3]) : 1, want = count == 5 ? atoi(words[4]) : 0;
  double *xyz = malloc((size_t)n * 3 * sizeof(double) + 1), *took = malloc((size_t)repeats * sizeof(double));
  int32_t* part = malloc((size_t)n * sizeof(int32_t) + 1);
  rcbd_scene_options options = RCBD_SCENE_OPTIONS;
  rcbd_near near = RCBD_NEAR;
  rcbd_client* client;
  rcbd_scene* scene;
  rcbd_cuts* cuts;
  int64_t i;
  int k;
  if (count != 5 || xyz == NULL || took == NULL || part == NULL) return 2;
  for (i = 0; i < 3 * n; ++i) xyz[i] = fmod((double)i * 0.61803398875, 1.0);
  options.parts = 8;
  options.replace = 1;
  options.positions = "when-needed";
  must(rcbd_connect(words[1], NULL, &client));
  must(rcbd_scene_open(client, "timing", &options, &scene));
  for (k = -1; k < repeats; ++k) {
    const double begin = now();
    rcbd_positions positions = rcbd_rows(xyz, n, 3);
    rcbd_step_options with = RCBD_STEP_OPTIONS;
    rcbd_report report = RCBD_REPORT;
    rcbd_result* result;
    with.want_parts = with.want_changed = want;
    must(rcbd_step(scene, &positions, &with, &result));
    must(rcbd_result_report(result, &report));
    rcbd_release(result);
    if (k >= 0) took[k] = now() - begin;
    if (k >= 0 && report.sent) return 3;
  }
  print_median(took, repeats);
  must(rcbd_scene_cuts(scene, &cuts));
  for (k = 0; k < repeats; ++k) {
    const double begin = now();
    const rcbd_positions positions = rcbd_rows(xyz, n, 3);
    must(rcbd_cuts_owner(cuts, &positions, NULL, part));
    took[k] = now() - begin;
  }
  print_median(took, repeats);
  near.width = 0.02;
  for (k = 0; k < repeats; ++k) {
    const double begin = now();
    const rcbd_positions positions = rcbd_rows(xyz, n, 3);
    rcbd_lists_view view = RCBD_LISTS_VIEW;
    rcbd_lists* lists;
    must(rcbd_cuts_halo(cuts, &positions, &near, NULL, &lists));
    must(rcbd_lists_read(lists, &view));
    rcbd_release(lists);
    took[k] = now() - begin;
  }
  print_median(took, repeats);
  rcbd_release(cuts);
  rcbd_release(scene);
  rcbd_release(client);
  free(xyz);
  free(took);
  free(part);
  return 0;
}
