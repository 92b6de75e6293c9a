// A solver of one process in C++14: 3,000 points that drift, 100 steps, in 8 parts. Prints when new cuts were made.
#include <cmath>
#include <cstdio>
#include <rcbd/rcbd.hpp>

int main() try {
  std::vector<double> xyz(9000);
  for (int i = 0; i < 9000; ++i) xyz[i] = std::fmod(i * 0.61803398875, 1.0);
  rcbd::Client client = rcbd::connect();
  rcbd::SceneOptions options;
  options.parts = 8;
  options.replace = true;
  rcbd::Scene scene = client.scene_open("serial", options);
  for (int k = 0; k <= 100; ++k) {
    rcbd::Step step = scene.step(xyz);
    if (step.report().repartitioned) std::printf("step %d: %s\n", k, step.report().reason);
    for (int i = 0; i < 4500; ++i) xyz[i] *= 0.99;  // the solver's own work: half of them drift
  }
} catch (const rcbd::Error& error) {
  std::fprintf(stderr, "%s; %s\n", error.what(), error.hint().c_str());
  return 1;
}
