/* What the C test programs share: a service to be asked, points, and checks that say what they found instead. */
#ifndef RCBD_TESTS_CLIENT_C_EXPECT_H
#define RCBD_TESTS_CLIENT_C_EXPECT_H

#include <math.h>
#include <rcbd/rcbd.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define N 3000
#define EXPECT(condition) expect((condition) != 0, #condition, __LINE__)
#define EXPECT_CODE(wanted, call) expect_code((wanted), (call), #call, __LINE__)
#define MUST(call) EXPECT_CODE(RCBD_OK, call)

static void expect(int right, const char* what, int line) {
  if (right) return;
  fprintf(stderr, "line %d: not so: %s; the last message was: %s\n", line, what, rcbd_message());
  exit(1);
}

static void expect_code(int wanted, int code, const char* what, int line) {
  if (code == wanted && (code <= RCBD_OK || strlen(rcbd_message()) > 5)) return;
  fprintf(stderr, "line %d: %s: %s, not %s: %s\n", line, what, rcbd_code_name(code), rcbd_code_name(wanted),
          rcbd_message());
  exit(1);
}

static const char* endpoint;
static double xyz[N][3];

static inline rcbd_client* connected(void) {
  rcbd_client* client;
  MUST(rcbd_connect(endpoint, NULL, &client));
  return client;
}

static inline rcbd_scene* opened(rcbd_client* client, const char* name) {
  rcbd_scene_options options = RCBD_SCENE_OPTIONS;
  rcbd_scene* scene;
  options.parts = 8;
  options.replace = 1;
  MUST(rcbd_scene_open(client, name, &options, &scene));
  return scene;
}

static inline rcbd_positions all(void) { return rcbd_rows(xyz[0], N, 3); }

static inline void scatter(void) {
  int i;
  for (i = 0; i < 3 * N; ++i) xyz[i / 3][i % 3] = fmod(i * 0.61803398875, 1.0);
}

struct test_case {
  const char* name;
  void (*run)(void);
};

/* Without arguments lists the cases; PROGRAM ENDPOINT CASE runs one against a service with nothing in it. */
static inline int run_case(int count, char** arguments, const struct test_case* cases, size_t number) {
  size_t k;
  if (count == 1) /* lists them */
    for (k = 0; k < number; ++k) puts(cases[k].name);
  if (count != 3) return count == 1 ? 0 : 2;
  endpoint = arguments[1];
  scatter();
  for (k = 0; k < number; ++k)
    if (strcmp(arguments[2], cases[k].name) == 0) {
      cases[k].run();
      return 0;
    }
  return 2;
}

#endif
