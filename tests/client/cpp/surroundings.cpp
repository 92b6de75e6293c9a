// Surroundings in which a C++ solver may call: other threads, forks, signals; and steps that somebody ends.
#include <csignal>
#include <thread>

#include <sys/wait.h>
#include <unistd.h>

#include "expect.hpp"

namespace {

void two_threads() {
  const std::vector<double> xyz = points();
  const rcbd::Client client = rcbd::connect(endpoint());
  const rcbd::Scene one = opened(client, "one"), two = opened(client, "two");
  const rcbd::Step shared = one.step(xyz);
  rcbd::StepOptions options;
  options.want_changed = true;
  std::vector<std::thread> threads;
  for (const rcbd::Scene& scene : {one, two, one})
    threads.emplace_back([&, scene] {
      for (int k = 0; k < 50; ++k) {
        const rcbd::Step copy = k % 2 == 0 ? scene.step(xyz, options) : rcbd::Step(shared);
        EXPECT(copy.report().n == kPoints && copy.leaving().rows.empty());
      }
    });
  // A failure is told to the thread that called.
  for (int k = 0; k < 50; ++k) EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "NULL", rcbd::Scene().step(xyz));
  for (std::thread& thread : threads) thread.join();
  EXPECT(one.last_step() == 50 && two.last_step() == 24);
}

void in_the_child(const rcbd::Client& client, const rcbd::Scene& scene, const rcbd::Cuts& cuts, const rcbd::Op& op) {
  const std::vector<double> xyz = points();
  EXPECT_ERROR(RCBD_UNSUPPORTED, "forked", scene.step(xyz));
  EXPECT_ERROR(RCBD_UNSUPPORTED, "forked", rcbd::Scene(scene).step(xyz));  // also of a copy
  EXPECT_ERROR(RCBD_UNSUPPORTED, "forked", scene.step_begin(xyz));
  EXPECT_ERROR(RCBD_UNSUPPORTED, "forked", scene.close());
  EXPECT_ERROR(RCBD_UNSUPPORTED, "forked", client.close());
  EXPECT_ERROR(RCBD_UNSUPPORTED, "forked", cuts.hash());
  EXPECT_ERROR(RCBD_UNSUPPORTED, "forked", op.wait());
  client.interrupt();
  const rcbd::Client own = rcbd::connect(endpoint());
  EXPECT(opened(own, "child").step(xyz).report().n == kPoints);
}

void forked() {
  const std::vector<double> xyz = points();
  const rcbd::Client client = rcbd::connect(endpoint());
  const rcbd::Scene scene = opened(client, "forked");
  const rcbd::Op op = scene.step_begin(xyz);  // so that there is a thread
  op.wait();
  const rcbd::Cuts cuts = scene.cuts();
  const pid_t child = ::fork();
  if (child == 0) {
    in_the_child(client, scene, cuts, op);
    std::exit(0);
  }
  int status = 0;
  EXPECT(::waitpid(child, &status, 0) == child && WIFEXITED(status) && WEXITSTATUS(status) == 0);
  EXPECT(scene.step(xyz).report().step == 1 && client.notices().empty());  // on the same connection
}

const rcbd::Client* interrupted_client = nullptr;
void on_alarm(int) { interrupted_client->interrupt(); }

// A seat that is missing keeps a step waiting.
void ended() {
  const std::vector<double> xyz = points();
  std::vector<std::int64_t> ids;
  for (std::size_t i = 0; i < kPoints; ++i) ids.push_back(static_cast<std::int64_t>(i));
  const rcbd::Client client = rcbd::connect(endpoint());
  rcbd::SceneOptions options;
  options.parts = options.seats = 2;
  options.replace = true;
  const rcbd::Scene scene = client.scene_open("ended", options);
  rcbd::StepOptions with;
  with.ids = ids;
  const rcbd::Op op = scene.step_begin(xyz, with);
  EXPECT(!op.wait(0) && !op.wait(0.05));
  EXPECT_ERROR(RCBD_BUSY, "'ended'", scene.step(xyz, with));
  std::thread canceller([op] { op.cancel(); });
  EXPECT_ERROR(RCBD_INTERRUPTED, "", op.wait());
  EXPECT_ERROR(RCBD_INTERRUPTED, "", op.wait(0));
  canceller.join();
  interrupted_client = &client;
  std::signal(SIGALRM, on_alarm);
  ::ualarm(200000, 0);
  EXPECT_ERROR(RCBD_INTERRUPTED, "", scene.step(xyz, with));
  (void)scene.step_begin(xyz, with);  // nobody holds it: cancelled
  EXPECT(scene.last_step() == -1);
}

void begun() {
  const std::vector<double> xyz = points();
  const rcbd::Scene scene = opened(rcbd::connect(endpoint()), "begun");  // which holds its client
  rcbd::StepOptions options;
  options.want_parts = true;
  const rcbd::Op op = scene.step_begin(xyz, options);
  rcbd::Step step;
  while (!(step = op.wait(0.01))) continue;
  EXPECT(step.report().step == 0 && step.parts().size() == kPoints && op.wait().get() == step.get());
}

}  // namespace

int main(int count, char** arguments) {
  return run_case(count, arguments,
                  {{"two_threads", two_threads}, {"forked", forked}, {"ended", ended}, {"begun", begun}});
}
