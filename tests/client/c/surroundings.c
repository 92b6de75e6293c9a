/* Surroundings in which a solver may call: other threads, forks, signals, another floating-point environment; and steps
   that somebody ends. */
#define _GNU_SOURCE
#include <fenv.h>
#include <pthread.h>
#include <signal.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "expect.h"

struct work {
  rcbd_scene* scene;
  int made;
};

static void* step_often(void* pointer) {
  struct work* work = pointer;
  const rcbd_positions positions = all();
  int k;
  for (k = 0; k < 50; ++k) {
    rcbd_step_options options = RCBD_STEP_OPTIONS;
    options.want_changed = 1;
    MUST(rcbd_step(work->scene, &positions, &options, NULL));
    ++work->made;
  }
  return NULL;
}

static void two_threads(void) {
  rcbd_client* client = connected();
  struct work one = {opened(client, "one"), 0}, two = {opened(client, "two"), 0}, three = {one.scene, 0};
  pthread_t first, second, third;
  int64_t step;
  EXPECT(pthread_create(&first, NULL, step_often, &one) == 0 && pthread_create(&second, NULL, step_often, &two) == 0);
  EXPECT(pthread_create(&third, NULL, step_often, &three) == 0);
  pthread_join(first, NULL);
  pthread_join(second, NULL);
  pthread_join(third, NULL);
  MUST(rcbd_last_step(one.scene, &step));
  EXPECT(one.made == 50 && two.made == 50 && three.made == 50 && step == 99);
  rcbd_release(one.scene);
  rcbd_release(two.scene);
  rcbd_release(client);
}

static void forked(void) {
  rcbd_client* client = connected();
  rcbd_scene* scene = opened(client, "forked");
  const rcbd_positions positions = all();
  rcbd_cuts* cuts;
  rcbd_op* op;
  int64_t step;
  int status, k;
  MUST(rcbd_step_begin(scene, &positions, NULL, &op)); /* so that there is a thread */
  MUST(rcbd_wait(op, -1, NULL));
  MUST(rcbd_scene_cuts(scene, &cuts));
  for (k = 0; k < 2; ++k) {
    const pid_t child = fork();
    if (child == 0) {
      rcbd_client* own;
      rcbd_cuts_info info = RCBD_CUTS_INFO;
      EXPECT_CODE(RCBD_UNSUPPORTED, rcbd_step(scene, &positions, NULL, NULL));
      EXPECT(strstr(rcbd_message(), "forked") != NULL);
      EXPECT_CODE(RCBD_UNSUPPORTED, rcbd_step_begin(scene, &positions, NULL, &op));
      EXPECT_CODE(RCBD_UNSUPPORTED, rcbd_cuts_describe(cuts, &info));
      EXPECT_CODE(RCBD_UNSUPPORTED, rcbd_close(scene));
      EXPECT_CODE(RCBD_UNSUPPORTED, rcbd_close(client));
      rcbd_interrupt(client);
      rcbd_release(op);
      rcbd_release(scene);
      rcbd_release(client);
      rcbd_release(cuts);
      MUST(rcbd_connect(endpoint, NULL, &own));
      rcbd_release(own);
      if (k == 0) _exit(0);
      exit(0);
    }
    EXPECT(waitpid(child, &status, 0) == child && WIFEXITED(status) && WEXITSTATUS(status) == 0);
    MUST(rcbd_step(scene, &positions, NULL, NULL)); /* on the same connection: the scene is still held */
  }
  MUST(rcbd_last_step(scene, &step));
  EXPECT(step == 2 && rcbd_notice(client) == NULL);
  rcbd_release(op);
  rcbd_release(cuts);
  rcbd_release(scene);
  rcbd_release(client);
}

static double path[20][N][3];

/* Computed before the rounding is another one. */
static void drift(void) {
  int step, i;
  for (step = 0; step < 20; ++step) {
    memcpy(path[step], xyz, sizeof xyz);
    for (i = 0; i < N / 2; ++i) xyz[i][i % 3] *= 0.9;
  }
  scatter();
}

static uint64_t hash_after_steps(rcbd_scene* scene) {
  rcbd_cuts_info info = RCBD_CUTS_INFO;
  rcbd_cuts* cuts;
  int step;
  for (step = 0; step < 20; ++step) {
    const rcbd_positions positions = rcbd_rows(path[step][0], N, 3);
    MUST(rcbd_step(scene, &positions, NULL, NULL));
  }
  MUST(rcbd_scene_cuts(scene, &cuts));
  MUST(rcbd_cuts_describe(cuts, &info));
  EXPECT(info.epoch > 2);
  rcbd_release(cuts);
  return info.hash;
}

static void surroundings(void) {
  rcbd_client* client = connected();
  rcbd_scene* scene = opened(client, "calm");
  static const int roundings[] = {FE_UPWARD, FE_DOWNWARD, FE_TOWARDZERO};
  rcbd_step_options options = RCBD_STEP_OPTIONS;
  rcbd_op* op;
  rcbd_positions positions;
  uint64_t calm;
  size_t k;
  drift();
  calm = hash_after_steps(scene);
  rcbd_release(scene);
  for (k = 0; k < 3; ++k) {
    fesetround(roundings[k]);
    scene = opened(client, "rounded");
    EXPECT(hash_after_steps(scene) == calm && fegetround() == roundings[k]);
    rcbd_release(scene);
    fesetround(FE_TONEAREST);
  }
  feclearexcept(FE_ALL_EXCEPT);
  feenableexcept(FE_DIVBYZERO | FE_INVALID | FE_OVERFLOW | FE_UNDERFLOW | FE_INEXACT);
  scene = opened(client, "trapping");
  {
    rcbd_report report = RCBD_REPORT;
    rcbd_cuts_info info = RCBD_CUTS_INFO;
    rcbd_near near = RCBD_NEAR;
    rcbd_result* result;
    rcbd_cuts* cuts;
    rcbd_lists* lists;
    int32_t part, axis;
    double width;
    positions = all();
    options.threads = 4;
    options.want_changed = 1;
    MUST(rcbd_step(scene, &positions, &options, &result));
    MUST(rcbd_result_report(result, &report));
    rcbd_release(result);
    MUST(rcbd_scene_cuts(scene, &cuts));
    MUST(rcbd_cuts_describe(cuts, &info));
    MUST(rcbd_cuts_neighbours(cuts, 0, &near, &lists));
    rcbd_release(lists);
    MUST(rcbd_cuts_halo(cuts, &positions, &near, NULL, &lists));
    rcbd_release(lists);
    MUST(rcbd_cuts_narrowest(cuts, NULL, &part, &axis, &width));
    rcbd_release(cuts);
    MUST(rcbd_step_begin(scene, &positions, &options, &op)); /* a thread inherits the traps of who starts it */
    MUST(rcbd_wait(op, -1, NULL));
    rcbd_release(op);
    {
      const uint64_t bits = 0x7ff8000000000000; /* NaN */
      memcpy(&xyz[3][0], &bits, sizeof bits);
    }
    EXPECT_CODE(RCBD_NOT_FINITE, rcbd_step(scene, &positions, &options, NULL));
  }
  EXPECT(fegetexcept() == (FE_DIVBYZERO | FE_INVALID | FE_OVERFLOW | FE_UNDERFLOW | FE_INEXACT));
  EXPECT(fetestexcept(FE_ALL_EXCEPT) == 0); /* nor did anything of it get out */
  rcbd_release(scene);
  fedisableexcept(FE_ALL_EXCEPT);
  rcbd_release(client);
}

/* Denormals that a cut must tell from 0: linked with -ffast-math, a program's own threads take them for 0. */
static void denormals(void) {
  rcbd_client* client = connected();
  rcbd_scene_options options = RCBD_SCENE_OPTIONS;
  rcbd_positions positions;
  rcbd_scene* scene;
  rcbd_cuts* cuts;
  static double x[8];
  static const int64_t ids[5] = {1000, 1001, 1002, 1003, 1004};
  rcbd_ask_options ask = RCBD_ASK_OPTIONS;
  int32_t part[8];
  int k;
#if defined(__x86_64__)
  __builtin_ia32_ldmxcsr(__builtin_ia32_stmxcsr() | 0x8040);
#endif
  for (k = 0; k < 8; ++k) {
    const uint64_t bits = (uint64_t)k;
    memcpy(&x[k], &bits, sizeof bits);
  }
  positions = rcbd_rows(x, 8, 1);
  options.parts = 8;
  options.dims = 1;
  options.replace = 1;
  MUST(rcbd_scene_open(client, "denormals", &options, &scene));
  MUST(rcbd_step(scene, &positions, NULL, NULL));
  MUST(rcbd_scene_cuts(scene, &cuts));
  positions = rcbd_rows(&x[3], 5, 1);
  ask.ids = ids; /* by which all would be right of all cuts, if places were equal */
  MUST(rcbd_cuts_owner(cuts, &positions, &ask, part));
  for (k = 0; k < 5; ++k) EXPECT(part[k] == k + 3);
  rcbd_release(cuts);
  rcbd_release(scene);
  rcbd_release(client);
}

static rcbd_client* interrupted_client;
static void on_alarm(int number) {
  (void)number;
  rcbd_interrupt(interrupted_client);
}

static void* release_it(void* op) {
  rcbd_cancel(op);
  return NULL;
}

/* A seat that is missing keeps a step waiting. */
static void cancelled(void) {
  rcbd_client* client = connected();
  rcbd_scene_options options = RCBD_SCENE_OPTIONS;
  rcbd_step_options with = RCBD_STEP_OPTIONS;
  const rcbd_positions positions = all();
  static int64_t ids[N];
  struct itimerspec soon;
  rcbd_scene *scene, *another;
  rcbd_result* result;
  rcbd_op *op, *second;
  pthread_t thread;
  timer_t timer;
  int i;
  memset(&soon, 0, sizeof soon);
  soon.it_value.tv_nsec = 200000000;
  for (i = 0; i < N; ++i) ids[i] = i;
  with.ids = ids;
  options.parts = 2;
  options.seats = 2;
  options.replace = 1;
  MUST(rcbd_scene_open(client, "cancelled", &options, &scene));
  MUST(rcbd_step_begin(scene, &positions, &with, &op));
  EXPECT_CODE(RCBD_PENDING, rcbd_wait(op, 0, &result));
  EXPECT_CODE(RCBD_PENDING, rcbd_wait(op, 0.05, &result));
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_wait(op, NAN, &result));
  options.deadline_seconds = 0.1; /* which is over before the step: the failure doesn't wait for the turn again */
  EXPECT_CODE(RCBD_BUSY, rcbd_scene_open(client, "another", &options, &another));
  EXPECT_CODE(RCBD_PENDING, rcbd_wait(op, 0, &result));
  EXPECT_CODE(RCBD_BUSY, rcbd_step(scene, &positions, &with, &result));
  EXPECT_CODE(RCBD_BUSY, rcbd_step_begin(scene, &positions, &with, &second));
  EXPECT(pthread_create(&thread, NULL, release_it, op) == 0);
  EXPECT_CODE(RCBD_INTERRUPTED, rcbd_wait(op, -1, &result));
  EXPECT(result == NULL);
  EXPECT_CODE(RCBD_INTERRUPTED, rcbd_wait(op, 0, NULL));
  pthread_join(thread, NULL);
  rcbd_release(op);
  /* By a signal handler, in the thread that waits in rcbd_step. */
  interrupted_client = client;
  signal(SIGALRM, on_alarm);
  EXPECT(timer_create(CLOCK_MONOTONIC, NULL, &timer) == 0 && timer_settime(timer, 0, &soon, NULL) == 0);
  EXPECT_CODE(RCBD_INTERRUPTED, rcbd_step(scene, &positions, &with, &result));
  /* The last holder lets go: the step is cancelled. */
  MUST(rcbd_step_begin(scene, &positions, &with, &op));
  rcbd_release(scene);
  rcbd_release(client);
  rcbd_release(op);
}

struct one_step {
  rcbd_scene* scene;
  int code;
};

static void* step_alone(void* of) {
  struct one_step* one = (struct one_step*)of;
  const rcbd_positions positions = all();
  one->code = rcbd_step(one->scene, &positions, NULL, NULL);
  return NULL;
}

static rcbd_op* begun(rcbd_client* client, rcbd_scene* scene) {
  const rcbd_positions none = rcbd_rows(NULL, 0, 3);
  rcbd_scene_options soon = RCBD_SCENE_OPTIONS;
  rcbd_scene* no_scene;
  rcbd_op* op;
  int code;
  MUST(rcbd_step_begin(scene, &none, NULL, &op));
  soon.deadline_seconds = 0.1;
  do code = rcbd_scene_open(client, "nothing", &soon, &no_scene);
  while (code == RCBD_NOT_FOUND);
  EXPECT_CODE(RCBD_BUSY, code); /* so it is the step's turn */
  return op;
}

/* An interrupt ends the calls under way, also one that waits for its turn, and no later one. */
static void interrupted(void) {
  rcbd_client *client = connected(), *other = connected();
  rcbd_scene_options options = RCBD_SCENE_OPTIONS;
  const rcbd_positions none = rcbd_rows(NULL, 0, 3);
  const struct timespec while_it_waits = {0, 300000000};
  struct one_step one;
  rcbd_scene* seat[2];
  rcbd_op *first, *second;
  pthread_t thread;
  int round, code;
  options.parts = options.seats = 2;
  options.replace = 1;
  MUST(rcbd_scene_open(client, "interrupted", &options, &seat[0]));
  options.seat = 1;
  MUST(rcbd_scene_open(other, "interrupted", &options, &seat[1]));
  for (round = 0; round < 12; ++round) {
    first = begun(client, seat[0]); /* waits for the other seat */
    if (round % 2 == 0) rcbd_interrupt(client);
    MUST(rcbd_step_begin(seat[1], &none, NULL, &second));
    code = rcbd_wait(first, -1, NULL); /* it may have ended by itself */
    if (round % 2 == 0 && code == RCBD_INTERRUPTED) code = rcbd_step(seat[0], &none, NULL, NULL);
    EXPECT_CODE(RCBD_OK, code);
    MUST(rcbd_wait(second, -1, NULL));
    rcbd_release(first);
    rcbd_release(second);
  }
  one.scene = opened(client, "alone");
  first = begun(client, seat[0]);
  EXPECT(pthread_create(&thread, NULL, step_alone, &one) == 0);
  nanosleep(&while_it_waits, NULL);
  rcbd_interrupt(client);
  pthread_join(thread, NULL);
  EXPECT(one.code == RCBD_INTERRUPTED);
  EXPECT_CODE(RCBD_INTERRUPTED, rcbd_wait(first, -1, NULL));
  rcbd_release(first);
  rcbd_release(one.scene);
  rcbd_release(seat[0]);
  rcbd_release(seat[1]);
  rcbd_release(client);
  rcbd_release(other);
}

/* Signals are for the program's threads: no other one takes them. */
static void signals(void) {
  rcbd_client* client = connected();
  rcbd_scene* scene = opened(client, "signals");
  const rcbd_positions positions = all();
  rcbd_op* op;
  char line[256];
  FILE* tasks;
  int threads = 0;
  MUST(rcbd_step_begin(scene, &positions, NULL, &op));
  MUST(rcbd_wait(op, -1, NULL));
  rcbd_release(op);
  tasks = popen("cat /proc/$PPID/task/*/status | grep SigBlk", "r");
  EXPECT(tasks != NULL);
  while (fgets(line, sizeof line, tasks) != NULL) {
    const unsigned long long blocked = strtoull(line + 7, NULL, 16);
    if (threads++ > 0) EXPECT((blocked & 0x7ffbfeff) == 0x7ffbfeff); /* all but KILL and STOP; of the first 31 */
  }
  pclose(tasks);
  EXPECT(threads >= 2);
  rcbd_release(scene);
  rcbd_release(client);
}

int main(int count, char** arguments) {
  static const struct test_case cases[] = {
      {"two_threads", two_threads}, {"forked", forked},           {"surroundings", surroundings},
      {"denormals", denormals},     {"interrupted", interrupted}, {"cancelled", cancelled},
      {"signals", signals}};
  return run_case(count, arguments, cases, sizeof cases / sizeof cases[0]);
}
