/* What rcbd/mpi.h says of failures: on one process, to all; and of wrong use. mpi_failures ENDPOINT. */
#include "scene.h"

/* The MPI of this program may fail to begin messages. */
static int failing;
int MPI_Irecv(void* data, int n, MPI_Datatype type, int from, int tag, MPI_Comm comm, MPI_Request* request) {
  return failing ? MPI_ERR_OTHER : PMPI_Irecv(data, n, type, from, tag, comm, request);
}

static const char* endpoint;

/* All processes have failed alike, with this code, this message of that process, and can go on. */
static void failed(int code, int expected, int by, const char* message) {
  char prefix[40], text[600];
  snprintf(prefix, sizeof(prefix), "process %d: ", by);
  snprintf(text, sizeof(text), "%s, not %s of %s%s", rcbd_code_name(code), rcbd_code_name(expected), prefix, message);
  ensure(code == expected && strncmp(rcbd_mpi_message(), prefix, strlen(prefix)) == 0 &&
             strstr(rcbd_mpi_message(), message) != NULL,
         text);
}

/* This process alone, by wrong use. */
static void refused(int code, int expected, const char* message) {
  ensure(code == expected && strstr(rcbd_mpi_message(), message) != NULL, message);
}

static void opening(rcbd_client* client) {
  const int last = size - 1;
  rcbd_client* another;
  rcbd_scene_options options = RCBD_SCENE_OPTIONS;
  rcbd_client* mine = client;
  rcbd_scene* scene;
  options.parts = size;
  options.replace = 1;
  failed(rcbd_mpi_connect(MPI_COMM_WORLD, rank == last ? "unix:/nowhere/s" : endpoint, NULL, &another),
         RCBD_UNAVAILABLE, last, "no service");
  ensure(another == NULL, "no client");
  failed(rcbd_mpi_connect(MPI_COMM_WORLD, endpoint, NULL, rank == last ? NULL : &another), RCBD_INVALID_ARGUMENT, last,
         "");
  if (rank == last) rcbd_connect("unix:/nowhere/s", NULL, &mine);
  failed(rcbd_mpi_scene_open(MPI_COMM_WORLD, mine, "failures", &options, &scene), RCBD_UNAVAILABLE, last, "no service");
  ensure(scene == NULL, "no scene");
  failed(rcbd_mpi_scene_open(MPI_COMM_WORLD, client, "a name", &options, &scene), RCBD_INVALID_ARGUMENT, 0, "name");
  options.dims = rank == last ? 4 : 3;
  failed(rcbd_mpi_scene_open(MPI_COMM_WORLD, client, "failures", &options, &scene),
         size > 1 ? RCBD_ALREADY_EXISTS : RCBD_INVALID_ARGUMENT, last, "4"); /* where the first has made it already */
  ensure(scene == NULL, "no scene");
}

static void agreeing(void) {
  const int last = size - 1;
  well(rcbd_mpi_agree(MPI_COMM_WORLD, RCBD_OK, "", ""));
  failed(rcbd_mpi_agree(MPI_COMM_WORLD, rank == last ? RCBD_IO_ERROR : RCBD_OK, "disk full", "buy one"), RCBD_IO_ERROR,
         last, "disk full");
  ensure(strcmp(rcbd_mpi_hint(), "buy one") == 0, "the hint");
  failed(rcbd_mpi_agree(MPI_COMM_WORLD, RCBD_ABORTED, "all of us", ""), RCBD_ABORTED, 0, "all of us");
  failed(rcbd_mpi_agree(MPI_COMM_WORLD, rank == last ? RCBD_NOT_FINITE : RCBD_ABORTED, "why", ""), RCBD_NOT_FINITE,
         last, "why");
}

/* A step of one process fails by what it gives; it closes its scene, and no other waits for it. */
static void a_step(rcbd_client* client) {
  const int last = size - 1;
  scene_of_all s;
  rcbd_mpi_moves* moves;
  rcbd_result* result;
  double nan[3] = {NAN, 0, 0};
  int64_t id = rank;
  rcbd_step_options step = RCBD_STEP_OPTIONS;
  rcbd_positions positions = rcbd_rows(nan, 1, 3);
  make_scene(&s, client, 2);
  step.ids = &id;
  if (rank != last) nan[0] = rank;
  if (rcbd_step(s.scene, &positions, &step, &result) != RCBD_OK) rcbd_close(s.scene);
  ensure(result == NULL, "no result");
  ensure(rcbd_mpi_moves_new(MPI_COMM_WORLD, result, 1, &moves) == RCBD_ABORTED, "the step fails for all");
  ensure(strncmp(rcbd_mpi_message(), "process 0: ", 11) == 0 && strlen(rcbd_mpi_message()) > 20, "with a message");
  ensure(moves == NULL, "no moves");
  free_scene(&s);
  make_scene(&s, client, 2);
  failed(rcbd_mpi_step(MPI_COMM_WORLD, s.scene, &positions, &step, &result), RCBD_NOT_FINITE, 0, "nan");
  ensure(result == NULL, "no result");
  free_scene(&s);
}

static void plans(scene_of_all* s, rcbd_result* result) {
  const int last = size - 1;
  double nan[3] = {NAN, 0, 0}, wrong_box[3] = {0, 0, 0};
  const rcbd_positions none = rcbd_rows(nan, 0, s->dims), bad = rcbd_rows(nan, 1, s->dims);
  rcbd_near near = RCBD_NEAR;
  rcbd_mpi_moves* moves;
  rcbd_mpi_halo* halo;
  failed(rcbd_mpi_moves_new(MPI_COMM_WORLD, result, rank == last ? -1 : s->count[rank], &moves), RCBD_INVALID_ARGUMENT,
         last, "rows: -1");
  failed(rcbd_mpi_moves_new(MPI_COMM_WORLD, result, s->count[rank], rank == last ? NULL : &moves),
         RCBD_INVALID_ARGUMENT, last, "null pointer");
  failed(rcbd_mpi_halo_new(MPI_COMM_WORLD, s->cuts, &none, &near, NULL, rank == last ? NULL : &halo),
         RCBD_INVALID_ARGUMENT, last, "null pointer");
  failed(rcbd_mpi_halo_new(MPI_COMM_WORLD, rank == last ? NULL : s->cuts, &none, &near, NULL, &halo), RCBD_ABORTED,
         last, "");
  failed(rcbd_mpi_halo_new(MPI_COMM_WORLD, s->cuts, rank == last ? &bad : &none, &near, NULL, &halo), RCBD_NOT_FINITE,
         last, "finite");
  failed(rcbd_mpi_halo_new(MPI_COMM_WORLD, s->cuts, NULL, &near, NULL, &halo), RCBD_INVALID_ARGUMENT, 0, "positions");
  near.lo = near.hi = wrong_box;
  failed(rcbd_mpi_halo_new(MPI_COMM_WORLD, s->cuts, &none, &near, NULL, &halo), RCBD_INVALID_ARGUMENT, 0, "");
  ensure(halo == NULL && moves == NULL, "no plans");
}

/* All of these send nothing, so that each process can go on by itself. */
static void wrong_use(rcbd_mpi_halo* halo, rcbd_mpi_moves* moves) {
  const int64_t all = halo->rows + halo->ghosts, most = moves->rows > moves->before ? moves->rows : moves->before;
  double* x = calloc((size_t)(all + most) + 1, 24);
  const rcbd_mpi_field right = {x, all, MPI_DOUBLE, halo->dims, 1};
  rcbd_mpi_field many[17], one = right;
  int k;
  for (k = 0; k < 17; ++k) many[k] = right;
  refused(rcbd_mpi_forward(halo, halo->rows + 1, &right, 1), RCBD_INVALID_ARGUMENT, "another number of rows");
  refused(rcbd_mpi_reverse_add(halo, halo->rows - 1, &right), RCBD_INVALID_ARGUMENT, "another number of rows");
  refused(rcbd_mpi_forward(NULL, 0, &right, 1), RCBD_INVALID_ARGUMENT, "no halo");
  refused(rcbd_mpi_reverse_add(NULL, 0, &right), RCBD_INVALID_ARGUMENT, "no halo");
  refused(rcbd_mpi_move(NULL, &right, 1), RCBD_INVALID_ARGUMENT, "no moves");
  refused(rcbd_mpi_forward(halo, halo->rows, many, 17), RCBD_INVALID_ARGUMENT, "17");
  refused(rcbd_mpi_forward(halo, halo->rows, many, 0), RCBD_INVALID_ARGUMENT, "fields");
  refused(rcbd_mpi_forward(halo, halo->rows, NULL, 1), RCBD_INVALID_ARGUMENT, "fields");
  one.room = all - 1;
  refused(rcbd_mpi_forward(halo, halo->rows, &one, 1), RCBD_INVALID_ARGUMENT, "has room for");
  refused(rcbd_mpi_reverse_add(halo, halo->rows, &one), RCBD_INVALID_ARGUMENT, "has room for");
  one.room = most - 1;
  refused(rcbd_mpi_move(moves, &one, 1), RCBD_INVALID_ARGUMENT, "has room for");
  one = right;
  one.columns = 0;
  refused(rcbd_mpi_forward(halo, halo->rows, &one, 1), RCBD_INVALID_ARGUMENT, "columns");
  one.columns = halo->dims + 1;
  refused(rcbd_mpi_forward(halo, halo->rows, &one, 1), RCBD_INVALID_ARGUMENT, "positions");
  one.columns = 1;
  one.positions = halo->dims + 1;
  refused(rcbd_mpi_forward(halo, halo->rows, &one, 1), RCBD_INVALID_ARGUMENT, "positions");
  one = right;
  one.type = MPI_INT64_T;
  refused(rcbd_mpi_forward(halo, halo->rows, &one, 1), RCBD_INVALID_ARGUMENT, "MPI_DOUBLE");
  one.positions = 0;
  one.type = MPI_CHAR;
  refused(rcbd_mpi_reverse_add(halo, halo->rows, &one), RCBD_UNSUPPORTED, "int64");
  one = right;
  one.data = NULL;
  if (all > 0) refused(rcbd_mpi_forward(halo, halo->rows, &one, 1), RCBD_INVALID_ARGUMENT, "room for 0");
  well(rcbd_mpi_forward(halo, halo->rows, &right, 1)); /* and all is well */
  free(x);
}

/* Before they are handed over: one process has them all. */
static void rows_of_others(scene_of_all* s, rcbd_result* result) {
  int64_t *ids = calloc((size_t)s->n + 1, 8), count;
  double* x = rows_of(s, ids);
  const rcbd_positions positions = rcbd_rows(x, s->count[rank], s->dims);
  const int64_t* row;
  const int32_t* seat;
  int by = 0;
  rcbd_near near = RCBD_NEAR;
  rcbd_ask_options ask = RCBD_ASK_OPTIONS;
  rcbd_mpi_halo* halo;
  char message[80];
  while (s->count[by] == 0) ++by;
  well(rcbd_result_leaving(result, &row, &seat, &count));
  MPI_Bcast(&count, 1, MPI_INT64_T, by, MPI_COMM_WORLD);
  snprintf(message, sizeof(message), "%d of %d rows belong to other processes", (int)count, (int)s->count[by]);
  ask.ids = ids;
  near.width = 0.1;
  if (size > 1)
    failed(rcbd_mpi_halo_new(MPI_COMM_WORLD, s->cuts, &positions, &near, &ask, &halo), RCBD_INVALID_ARGUMENT, by,
           message);
  free(ids);
  free(x);
}

/* At the end, since its message is not received any more. */
static void mpi_that_fails(rcbd_mpi_halo* halo) {
  const int64_t all = halo->rows + halo->ghosts;
  double* x = calloc((size_t)all + 1, 24);
  const rcbd_mpi_field field = {x, all, MPI_DOUBLE, halo->dims, 1};
  int code;
  failing = rank == size - 1;
  code = rcbd_mpi_forward(halo, halo->rows, &field, 1);
  ensure(code == (failing && size > 1 ? RCBD_INTERNAL : RCBD_OK), "what could not begin is told");
  free(x);
}

int main(int count, char** word) {
  scene_of_all s;
  rcbd_client* client = NULL;
  rcbd_result* result;
  rcbd_mpi_moves* moves;
  begin(&count, &word);
  endpoint = word[1];
  well(rcbd_mpi_connect(MPI_COMM_WORLD, endpoint, NULL, &client));
#if RCBD_MPI_SEATS_MAX < 2
  failed(rcbd_mpi_scene_open(MPI_COMM_WORLD, client, "failures", NULL, &s.scene), RCBD_TOO_LARGE, 0, "seats: 2");
  return MPI_Finalize();
#endif
  make_scene(&s, client, 1); /* one process has all */
  result = step_scene(&s);
#if RCBD_MPI_COUNT_MAX < 10
  {
    const int code = rcbd_mpi_moves_new(MPI_COMM_WORLD, result, s.count[rank], &moves);
    ensure(code == RCBD_TOO_LARGE && strstr(rcbd_mpi_message(), "than MPI can count: ") != NULL, "too many rows");
  }
#else
  opening(client);
  agreeing();
  a_step(client);
  plans(&s, result);
  well(rcbd_mpi_moves_new(MPI_COMM_WORLD, result, s.count[rank], &moves));
  {
    rcbd_mpi_halo* halo;
    rows_of_others(&s, result);
    look_up(&s);
    take_over(&s);
    halo = make_halo(&s);
    wrong_use(halo, moves);
    mpi_that_fails(halo);
    rcbd_mpi_halo_free(halo);
  }
  rcbd_mpi_moves_free(moves);
#endif
  rcbd_mpi_moves_free(NULL);
  rcbd_mpi_halo_free(NULL);
  rcbd_release(result);
  free_scene(&s);
  rcbd_release(client);
  MPI_Finalize();
  return 0;
}
