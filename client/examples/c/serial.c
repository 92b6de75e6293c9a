/* A solver of one process in C: 3,000 points that drift, 100 steps, in 8 parts. Prints when new cuts were made. */
#include <math.h>
#include <rcbd/rcbd.h>
#include <stdio.h>
#include <stdlib.h>

static void must(int code) {
  if (code == RCBD_OK) return;
  fprintf(stderr, "%s; %s\n", rcbd_message(), rcbd_hint());
  exit(1);
}

int main(void) {
  static double xyz[3000][3];
  rcbd_scene_options options = RCBD_SCENE_OPTIONS;
  rcbd_client* client;
  rcbd_scene* scene;
  int i, k;
  for (i = 0; i < 9000; ++i) xyz[i / 3][i % 3] = fmod(i * 0.61803398875, 1.0);
  options.parts = 8;
  options.replace = 1;
  must(rcbd_connect(NULL, NULL, &client));
  must(rcbd_scene_open(client, "serial", &options, &scene));
  for (k = 0; k <= 100; ++k) {
    rcbd_positions positions = rcbd_rows(xyz[0], 3000, 3);
    rcbd_report report = RCBD_REPORT;
    rcbd_result* result;
    must(rcbd_step(scene, &positions, NULL, &result));
    must(rcbd_result_report(result, &report));
    if (report.repartitioned) printf("step %d: %s\n", k, report.reason);
    rcbd_release(result);
    for (i = 0; i < 4500; ++i) xyz[i / 3][i % 3] *= 0.99; /* the solver's own work: half of them drift */
  }
  rcbd_release(scene);
  rcbd_release(client);
  return 0;
}
