/* A step that outlasts its service: c_waiting ENDPOINT makes a step, waits for a line, and makes the next one with a
   deadline that is too short for a service to come back. */
#include "expect.h"

int main(int count, char** arguments) {
  rcbd_step_options options = RCBD_STEP_OPTIONS;
  rcbd_positions positions;
  rcbd_client* client;
  rcbd_scene* scene;
  const char* notice;
  int code;
  if (count != 2) return 2;
  endpoint = arguments[1];
  scatter();
  positions = all();
  client = connected();
  scene = opened(client, "waiting");
  MUST(rcbd_step(scene, &positions, NULL, NULL));
  EXPECT(rcbd_notice(client) == NULL);
  puts("stepped");
  fflush(stdout);
  EXPECT(getchar() == '\n');
  options.deadline_seconds = 3;
  code = rcbd_step(scene, &positions, &options, NULL);
  while ((notice = rcbd_notice(client)) != NULL) printf("notice: %s\n", notice);
  printf("ended: %s: %s\n", rcbd_code_name(code), rcbd_message());
  rcbd_release(scene);
  rcbd_release(client);
  return 0;
}
