/* What questions about cuts answer, against their definitions. */
#include "expect.h"

static void wrap(void) {
  const double lo[3] = {-0.1, 0, 0}, hi[3] = {0.7, INFINITY, 3}, before = nextafter(-0.1, -1);
  const double open_lo[3] = {-0.1, -INFINITY, 0};
  double at[8][3] = {{-0.1, 5, 0},      {0.7, -5, 3}, {before, 0, 3.5},
                     {-0.2, 0, -1e-30}, {1e9, 0, -3}, {nextafter(0.7, 0), 0, 6},
                     {-1e300, 0, 7.5},  {0.3, 0, 2.5}};
  double kept[8][3];
  float single[4] = {0.7f, -0.1f, -0.25f, 1e30f};
  rcbd_positions positions = rcbd_rows(at[0], 8, 3), floats = rcbd_rows_f4(single, 4, 1);
  int i;
  memcpy(kept, at, sizeof at);
  EXPECT_CODE(RCBD_INVALID_ARGUMENT, rcbd_wrap(&positions, lo, hi)); /* half a period */
  EXPECT(memcmp(kept, at, sizeof at) == 0);
  MUST(rcbd_wrap(&positions, open_lo, hi));
  for (i = 0; i < 8; ++i) {
    EXPECT(at[i][0] >= lo[0] && at[i][0] < hi[0] && at[i][1] == kept[i][1] && at[i][2] >= 0 && at[i][2] < 3);
    if (kept[i][0] >= lo[0] && kept[i][0] < hi[0]) EXPECT(at[i][0] == kept[i][0]);
  }
  EXPECT(at[1][0] == lo[0] && at[1][2] == 0 && at[2][2] == 0.5 && at[3][2] == 0 && at[4][2] == 0 && at[5][2] == 0);
  EXPECT(at[2][0] == lo[0] || at[2][0] == before + (hi[0] - lo[0]));
  EXPECT(fabs(at[3][0] - 0.6) < 1e-15 && at[6][2] == 1.5);
  MUST(rcbd_wrap(&floats, lo, hi));
  for (i = 0; i < 4; ++i) EXPECT((double)single[i] >= lo[0] && (double)single[i] < hi[0]);
}

/* Halo, owner, parts and neighbours against what their definitions say. */
static void near_parts(void) {
  rcbd_client* client = connected();
  rcbd_scene* scene = opened(client, "near");
  const rcbd_positions positions = all();
  const double lo[3] = {0, -INFINITY, 0}, hi[3] = {1, INFINITY, 1};
  rcbd_step_options options = RCBD_STEP_OPTIONS;
  rcbd_near near = RCBD_NEAR;
  rcbd_lists_view view = RCBD_LISTS_VIEW, next = RCBD_LISTS_VIEW, touched = RCBD_LISTS_VIEW;
  rcbd_lists *halo, *neighbours, *box;
  rcbd_result* result;
  rcbd_cuts* cuts;
  static int32_t owner[N];
  double from[8][3], to[8][3];
  const int32_t* part;
  int64_t count, entry = 0, q, i;
  int a, sx, sz;
  options.want_parts = 1;
  MUST(rcbd_step(scene, &positions, &options, &result));
  MUST(rcbd_result_parts(result, &part, &count));
  MUST(rcbd_scene_cuts(scene, &cuts));
  MUST(rcbd_cuts_owner(cuts, &positions, NULL, owner));
  EXPECT(count == N && memcmp(owner, part, sizeof owner) == 0);
  MUST(rcbd_cuts_regions(cuts, from[0], to[0]));
  near.width = 0.07;
  near.lo = lo;
  near.hi = hi;
  MUST(rcbd_cuts_halo(cuts, &positions, &near, NULL, &halo));
  MUST(rcbd_lists_read(halo, &view));
  EXPECT(view.lists == 8 && view.offset[0] == 0 && view.offset[8] == view.entries && view.entries > 100);
  for (q = 0; q < 8; ++q)
    for (i = 0; i < N; ++i)
      for (sx = -1; sx <= 1; ++sx)
        for (sz = -1; sz <= 1; ++sz) {
          const double image[3] = {xyz[i][0] + sx, xyz[i][1], xyz[i][2] + sz};
          double distance = 0;
          for (a = 0; a < 3; ++a) {
            const double low = isinf(from[q][a]) && a != 1 ? 0 : from[q][a],
                         high = isinf(to[q][a]) && a != 1 ? 1 : to[q][a];
            distance = fmax(distance, fmax(low - image[a], image[a] - high));
          }
          if (distance > near.width || (owner[i] == q && sx == 0 && sz == 0)) continue;
          EXPECT(entry < view.offset[q + 1] && view.item[entry] == i);
          EXPECT(view.shift[3 * entry] == sx && view.shift[3 * entry + 1] == 0 && view.shift[3 * entry + 2] == sz);
          ++entry;
        }
  EXPECT(entry == view.entries);
  MUST(rcbd_cuts_neighbours(cuts, 3, &near, &neighbours));
  MUST(rcbd_lists_read(neighbours, &next));
  EXPECT(next.lists == 1 && next.entries > 3 && next.offset[1] == next.entries && next.shift != NULL);
  MUST(rcbd_cuts_box(cuts, from[3], to[3], NULL, &box));
  MUST(rcbd_lists_read(box, &touched));
  EXPECT(touched.entries > 1 && touched.shift == NULL);
  for (i = 0; i < touched.entries; ++i) EXPECT(touched.item[i] >= 0 && touched.item[i] < 8);
  rcbd_release(scene);
  rcbd_release(client);
  rcbd_release(result);
  rcbd_release(cuts);
  EXPECT(view.item[view.entries - 1] < N); /* lists need nobody else */
  rcbd_release(halo);
  rcbd_release(neighbours);
  rcbd_release(box);
}

int main(int count, char** arguments) {
  static const struct test_case cases[] = {{"wrap", wrap}, {"near", near_parts}};
  return run_case(count, arguments, cases, sizeof cases / sizeof cases[0]);
}
