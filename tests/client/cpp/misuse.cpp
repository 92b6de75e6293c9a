// What a C++ program may do wrong: each is an rcbd::Error in words.
#include "expect.hpp"

namespace {

void expect_null(const rcbd::Client& client, const rcbd::Scene& scene, const rcbd::Arrays<double>& arrays) {
  const std::vector<double> xyz = points();
  EXPECT(!client && !scene && !arrays);
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "NULL", client.scene_open("a"));
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "NULL", client.scene_drop("a"));
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "NULL", client.close());
  EXPECT(client.notices().empty());
  client.interrupt();
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "NULL", scene.step(xyz));
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "NULL", scene.step_begin(xyz));
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "NULL", scene.last_step());
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "NULL", scene.cuts());
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "NULL", scene.arrays(3));
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "NULL", scene.close());
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "NULL", arrays.axis());
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "NULL", arrays.count());
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "NULL", arrays.stride());
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "NULL", arrays.positions());
}

void expect_null(const rcbd::Op& op, const rcbd::Step& step, const rcbd::Cuts& cuts, const rcbd::Lists& lists) {
  const std::vector<double> xyz = points();
  EXPECT(!op && !step && !cuts && !lists);
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "NULL", op.wait());
  op.cancel();
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "NULL", step.report());
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "NULL", step.parts());
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "NULL", step.changed());
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "NULL", step.leaving());
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "NULL", cuts.hash());
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "NULL", cuts.regions());
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "NULL", cuts.owner(xyz));
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "NULL", cuts.halo(xyz, rcbd::Near{0.1}));
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "NULL", cuts.neighbours(0, rcbd::Near{0.1}));
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "NULL", cuts.box({0, 0, 0}, {1, 1, 1}));
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "NULL", cuts.narrowest());
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "NULL", lists.size());
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "NULL", lists.items());
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "NULL", lists.shifts());
}

void null_handles() {
  expect_null(rcbd::Client(), rcbd::Scene(), rcbd::Arrays<double>());
  expect_null(rcbd::Op(), rcbd::Step(), rcbd::Cuts(), rcbd::Lists());
}

void moved_from() {
  const std::vector<double> xyz = points();
  rcbd::Client client = rcbd::connect(endpoint());
  rcbd::Scene scene = opened(client, "moved");
  rcbd::Arrays<double> arrays = scene.arrays(10);
  rcbd::Op op = scene.step_begin(xyz);
  rcbd::Step step = op.wait();
  rcbd::Cuts cuts = scene.cuts();
  rcbd::Lists lists = cuts.neighbours(0, rcbd::Near{0.5});
  const rcbd::Client its = std::move(client);
  rcbd::Scene there;
  there = std::move(scene);
  const rcbd::Arrays<double> kept = std::move(arrays);
  expect_null(client, scene, arrays);
  const rcbd::Op done = std::move(op);
  const rcbd::Step told = std::move(step);
  const rcbd::Cuts same = std::move(cuts);
  const rcbd::Lists near = std::move(lists);
  expect_null(op, step, cuts, lists);
  EXPECT(there.last_step() == 0 && kept.count() == 10 && done.wait().report().step == told.report().step);
  EXPECT(same.parts() == 8 && near.items().size() > 0 && near.shifts().empty());
  scene = std::move(there);  // and is as good as before
  there = scene;
  EXPECT(scene.get() == there.get() && scene.step(xyz).report().step == 1);
  rcbd::Array<std::int64_t> rows = near.items();
  const rcbd::Array<std::int64_t> taken = std::move(rows);
  EXPECT(rows.data() == taken.data() && rows[0] == taken[0]);
}

void shapes() {
  const std::vector<double> xyz = points(), seven(7), three(3);
  const std::vector<std::int64_t> ids(5), none;
  const std::vector<std::array<double, 2>> flat(4);
  const rcbd::Client client = rcbd::connect(endpoint());
  const rcbd::Scene scene = opened(client, "shapes");
  rcbd::StepOptions with;
  rcbd::AskOptions ask;
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "7 numbers are no positions in 3 dimensions", scene.step(seven));
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "no positions in 0 dimensions", scene.step({seven, 0}));
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "7 values on one axis, 3 on another",
               scene.step(rcbd::Positions::axes(seven, seven, three)));
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "2 dimensions", scene.step(flat));
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "4 dimensions", scene.step({xyz, 4}));
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "4 dimensions",
               scene.step(rcbd::Positions::axes({&xyz[0], &xyz[1], &xyz[2], &xyz[3]}, 1, 3)));
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "a stride of 0",
               scene.step(rcbd::Positions::axes({&xyz[0], &xyz[1], &xyz[2]}, 1, 0)));
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "axis 0 is NULL", scene.step({static_cast<const double*>(nullptr), 5}));
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "of them", scene.step({xyz.data(), static_cast<std::size_t>(-1)}));
  with.ids = ids;
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "5 ids for 3000 positions", scene.step(xyz, with));
  with.ids = none;  // a mistake, not "no ids"
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "0 ids for 3000 positions", scene.step_begin(xyz, with));
  with.ids = {};
  with.weights = three;
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "3 weights for 3000 positions", scene.step(xyz, with));
  with.weights = {};
  with.threads = 0;
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "0 threads", scene.step(xyz, with));
  EXPECT_ERROR(RCBD_NOT_FOUND, "", scene.cuts());
  const rcbd::Step step = scene.step(xyz);
  EXPECT_ERROR(RCBD_NOT_FOUND, "", step.parts());
  EXPECT_ERROR(RCBD_NOT_FOUND, "", step.changed());
  const rcbd::Cuts cuts = scene.cuts();
  ask.widths = three;
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "3 widths for 3000 positions", cuts.halo(xyz, rcbd::Near{0.1}, ask));
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "", cuts.halo(xyz, rcbd::Near{-1}));
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "", cuts.halo(xyz, rcbd::Near{0.1, {{{0, 0, 0}}, {{1, 0, 1}}}}));
  EXPECT_ERROR(RCBD_NOT_FOUND, "", cuts.neighbours(8, rcbd::Near{0.1}));
  EXPECT_ERROR(RCBD_NOT_FOUND, "there are 1 lists", cuts.neighbours(0, rcbd::Near{0.1}).items(1));
  EXPECT_ERROR(RCBD_NOT_FOUND, "there are 1 lists",
               cuts.neighbours(0, rcbd::Near{0.1}).items(static_cast<std::size_t>(-1)));
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "", cuts.owner(xyz, nullptr));
  EXPECT_ERROR(RCBD_TOO_LARGE, "", scene.arrays(std::size_t(1) << 50));
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "11 positions of 10", scene.arrays(10).positions(11));
  EXPECT(scene.arrays(10).axis(3) == nullptr && scene.arrays(10).axis(-1) == nullptr);
}

void not_finite() {
  std::vector<double> xyz = points();
  const rcbd::Client client = rcbd::connect(endpoint());
  const rcbd::Scene scene = opened(client, "nan");
  scene.step(xyz);
  const rcbd::Cuts cuts = scene.cuts();
  xyz[3 * 17 + 1] = std::nan("");
  EXPECT_ERROR(RCBD_NOT_FINITE, "17", scene.step(xyz));
  EXPECT_ERROR(RCBD_NOT_FINITE, "17", scene.step_begin(xyz).wait());
  EXPECT_ERROR(RCBD_NOT_FINITE, "17", cuts.owner(xyz));
  EXPECT_ERROR(RCBD_NOT_FINITE, "17", cuts.halo(xyz, rcbd::Near{0.1}));
  EXPECT_ERROR(RCBD_NOT_FINITE, "17", rcbd::wrap(xyz, {0, 0, 0}, {1, 1, 1}));
  const std::vector<double> finite = points();
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "NaN", scene.step_begin(finite).wait(std::nan("")));
}

void closed() {
  const std::vector<double> xyz = points();
  const rcbd::Client client = rcbd::connect(endpoint());
  const rcbd::Scene scene = opened(client, "closed"), other = opened(client, "other");
  scene.step(xyz);
  scene.close();
  scene.close();
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "'closed' was closed", scene.step(xyz));
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "'closed' was closed", scene.step_begin(xyz).wait());
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "'closed' was closed", scene.last_step());
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "'closed' was closed", scene.arrays(5));
  EXPECT(other.step(xyz).report().step == 0);
  client.close();
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "client was closed", other.step(xyz));
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "client was closed", client.scene_open("closed"));
}

void options() {
  rcbd::ConnectOptions connect;
  connect.deadline_seconds = 0.2;
  EXPECT_ERROR(RCBD_UNAVAILABLE, "/nonexistent", rcbd::connect("unix:/nonexistent/rcbd.sock", connect));
  connect.path = "by post";
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "by post", rcbd::connect(endpoint(), connect));
  const rcbd::Client client = rcbd::connect(endpoint());
  EXPECT_ERROR(RCBD_NOT_FOUND, "", client.scene_open("options"));
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "", client.scene_open("no name"));
  rcbd::SceneOptions with;
  with.parts = 2;
  with.part_sizes = {1, 2, 3};
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "3 part sizes for 2 parts", client.scene_open("options", with));
  with.part_sizes = {1, 2};
  with.method = "by hand";
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "by hand", client.scene_open("options", with));
  with.method = "bands-x";
  const std::vector<double> xyz = points();
  rcbd::StepOptions step;
  step.want_parts = true;
  const rcbd::Array<std::int32_t> parts = client.scene_open("options", with).step(xyz, step).parts();
  std::size_t first = 0;
  for (const std::int32_t part : parts) first += part == 0;
  EXPECT(parts.size() == kPoints && first == kPoints / 3);
  with.tolerance = 0.2;
  EXPECT_ERROR(RCBD_ALREADY_EXISTS, "tolerance is 0.1, not 0.2", client.scene_open("options", with));
  client.scene_drop("options");
  EXPECT_ERROR(RCBD_NOT_FOUND, "", client.scene_drop("options"));
}

// An error is a std::exception, and can be kept.
void errors() {
  std::vector<rcbd::Error> kept;
  try {
    rcbd::check(rcbd_scene_drop(nullptr, "a"));
  } catch (const std::runtime_error& error) {
    kept.push_back(dynamic_cast<const rcbd::Error&>(error));
  }
  const std::string message = kept.at(0).what();
  EXPECT_ERROR(RCBD_UNAVAILABLE, "/nonexistent", rcbd::connect("unix:/nonexistent/rcbd.sock"));
  EXPECT(kept[0].message() == message && kept[0].what() == message &&
         std::string(kept[0].code_name()) == "invalid_argument");
  EXPECT(std::string(rcbd::Error(RCBD_DUPLICATE_ID, "a", "b").code_name()) == "duplicate_id" &&
         rcbd::Error(3, "a", "b").hint() == "b" && rcbd::Error(65538, "a").hint().empty());
}

}  // namespace

int main(int count, char** arguments) {
  return run_case(count, arguments,
                  {{"null_handles", null_handles},
                   {"moved_from", moved_from},
                   {"shapes", shapes},
                   {"not_finite", not_finite},
                   {"closed", closed},
                   {"options", options},
                   {"errors", errors}});
}
