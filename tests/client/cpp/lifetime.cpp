// Arrays, texts and answers stay what they were: after close, growth, later steps, and when all handles are gone. The
// test runs it with MALLOC_PERTURB_, so that memory that was freed is something else.
#include <algorithm>
#include <cstring>

#include "expect.hpp"

namespace {

template <typename T>
std::vector<T> copy(const rcbd::Array<T>& array) {
  return {array.begin(), array.end()};
}

// What a step told, and a copy of it.
struct Told {
  rcbd::Report report;
  rcbd::Array<std::int32_t> parts;
  rcbd::Changed changed;
  rcbd::Leaving leaving;
  std::string reason, way, json;
  std::vector<std::int32_t> part_copy, changed_to;
  std::vector<std::int64_t> changed_rows;

  explicit Told(const rcbd::Step& step)
      : report(step.report()),
        parts(step.parts()),
        changed(step.changed()),
        leaving(step.leaving()),
        reason(report.reason),
        way(report.way),
        json(report.json),
        part_copy(copy(parts)),
        changed_to(copy(changed.parts)),
        changed_rows(copy(changed.rows)) {}
  void expect_the_same() const {
    EXPECT(report.reason == reason && report.way == way && report.json == json && json.size() > 100);
    EXPECT(copy(parts) == part_copy && part_copy.size() == kPoints);
    EXPECT(copy(changed.parts) == changed_to && copy(changed.rows) == changed_rows && !changed.rows.empty());
    EXPECT(leaving.rows.empty() && leaving.seats.size() == 0);
  }
};

void results() {
  std::vector<double> xyz = points();
  rcbd::StepOptions options;
  options.want_parts = options.want_changed = true;
  std::vector<Told> told;
  {
    rcbd::Client client = rcbd::connect(endpoint());
    rcbd::Scene scene = opened(client, "results");
    for (int k = 0; k < 20; ++k) {
      told.emplace_back(scene.step(xyz, options));  // the step is gone at the end of the line; moved with the vector
      for (const Told& one : told) one.expect_the_same();
      for (std::size_t i = 0; i < xyz.size() / 2; ++i) xyz[i] *= 0.9;
      const Told replaced = told.back();
      told.back() = replaced;
    }
    client.close();
    for (const Told& one : told) one.expect_the_same();
  }
  for (const Told& one : told) one.expect_the_same();
  const rcbd::Report report = told[0].report;
  told.clear();
  EXPECT(std::strlen(report.json) > 100 && report.n == kPoints && report.parts == 8);
}

void answers() {
  const std::vector<double> xyz = points();
  rcbd::Array<std::int64_t> items;
  rcbd::Array<std::int32_t> shifts;
  std::vector<std::int64_t> item_copy;
  std::vector<std::int32_t> shift_copy;
  rcbd::Cuts cuts;
  {
    const rcbd::Client client = rcbd::connect(endpoint());
    const rcbd::Scene scene = opened(client, "answers");
    scene.step(xyz);
    cuts = scene.cuts();
    const rcbd::Lists halo = cuts.halo(xyz, {0.2, {{{0, 0, 0}}, {{1, 1, 1}}}, rcbd::Norm::euclid});
    items = halo.items(5);
    shifts = halo.shifts(5);
    item_copy = copy(items);
    shift_copy = copy(shifts);
    EXPECT(items.size() > 100 && shifts.size() == 3 * items.size() && halo.size() == 8 && halo.dims() == 3);
    EXPECT(halo.entries() > items.size() && cuts.box({0, 0, 0}, {1, 1, 1}).shifts().empty());
    client.close();
  }
  rcbd::Array<std::int64_t> alone = cuts.neighbours(5, rcbd::Near{0.2}).items();
  const std::vector<std::int64_t> alone_copy = copy(alone);
  { const rcbd::Array<std::int64_t> taken = std::move(alone); }  // which leaves it as it was
  EXPECT(copy(alone) == alone_copy && alone_copy.size() > 1);
  for (int k = 0; k < 100; ++k) (void)cuts.halo(xyz, rcbd::Near{0.2});
  EXPECT(copy(items) == item_copy && copy(shifts) == shift_copy);
  EXPECT(cuts.owner(xyz).size() == kPoints && cuts.regions().size() == 8 && cuts.epoch() == 1 && cuts.dims() == 3);
}

void arrays() {
  const std::vector<double> xyz = points();
  rcbd::Arrays<double> small, large;
  rcbd::Arrays<float> floats;
  const auto fill = [](const auto& array, float value) {
    for (int a = 0; a < 3; ++a)
      for (std::size_t i = 0; i < array.count(); ++i) array.axis(a)[i * array.stride()] = value;
  };
  {
    const rcbd::Client client = rcbd::connect(endpoint());
    const rcbd::Scene scene = opened(client, "arrays");
    small = scene.arrays(kPoints);
    std::copy(xyz.begin(), xyz.end(), small.axis());
    EXPECT(small.count() == kPoints && small.stride() == 3 && small.axis(2) == small.axis() + 2);
    scene.step(small);
    large = scene.arrays(40 * kPoints);
    EXPECT(large.axis() != small.axis() && std::equal(xyz.begin(), xyz.end(), large.axis()));
    const rcbd::Report of_large = scene.step(large.positions(kPoints)).report(), of_small = scene.step(small).report();
    EXPECT(of_large.step == 1 && of_large.n == kPoints && of_large.drifted == 0 && of_small.drifted == 0);
    rcbd::wrap(small, {0, 0, 0}, {0.5, 0.5, 0.5});
    EXPECT(*std::max_element(small.axis(), small.axis() + 3 * kPoints) < 0.5);
    floats = scene.arrays<float>(kPoints, rcbd::Layout::axes);
    EXPECT(floats.stride() == 1 && floats.axis(1) != nullptr);
    fill(small, 0.5F);
    scene.step(small);
    client.close();
  }
  fill(small, 1);
  fill(large, 2);
  fill(floats, 3);
  EXPECT(small.axis(2)[3 * (kPoints - 1)] == 1 && large.axis()[0] == 2 && floats.axis(2)[kPoints - 1] == 3);
}

// The last holder of a scene lets go of it in the service, so that others may make it anew; no other does.
void last_holder() {
  const std::vector<double> xyz = points();
  const rcbd::Client client = rcbd::connect(endpoint()), other = rcbd::connect(endpoint());
  rcbd::SceneOptions anew;
  anew.parts = 8;
  anew.replace = true;
  anew.deadline_seconds = 0.3;
  rcbd::Scene scene = opened(client, "last_holder");
  rcbd::Op op = scene.step_begin(xyz);
  op.wait();
  { const rcbd::Scene copy = scene; }
  EXPECT_ERROR(RCBD_BUSY, "'last_holder'", other.scene_open("last_holder", anew));
  scene = {};
  EXPECT_ERROR(RCBD_BUSY, "'last_holder'", other.scene_open("last_holder", anew));
  op = {};  // which held the scene
  EXPECT(other.scene_open("last_holder", anew).last_step() == -1);
}

std::uint64_t hash_of(const rcbd::Scene& scene, const rcbd::Positions& positions) {
  EXPECT(positions.count() == kPoints && positions.dims() == 3);
  EXPECT(scene.step(positions).report().drifted <= 0);  // the same places as in the step before
  return scene.cuts().hash();
}

struct Particle {
  double mass;
  double x, y, z;
};

// The same positions, whatever they are in.
void kinds_of_arrays() {
  std::vector<double> xyz = points(), x, y, z;
  std::vector<std::array<double, 3>> rows(kPoints);
  std::vector<Particle> particles(kPoints);
  static double table[kPoints][3];
  for (std::size_t i = 0; i < kPoints; ++i) {
    x.push_back(table[i][0] = rows[i][0] = particles[i].x = xyz[3 * i]);
    y.push_back(table[i][1] = rows[i][1] = particles[i].y = xyz[3 * i + 1]);
    z.push_back(table[i][2] = rows[i][2] = particles[i].z = xyz[3 * i + 2]);
  }
  const std::vector<double> constant = xyz;
  const rcbd::Client client = rcbd::connect(endpoint());
  const rcbd::Scene scene = opened(client, "kinds");
  const std::uint64_t hash = hash_of(scene, xyz);
  const std::size_t stride = sizeof(Particle) / sizeof(double);
  EXPECT(hash_of(scene, constant) == hash && hash_of(scene, {xyz.data(), kPoints}) == hash);
  EXPECT(hash_of(scene, rows) == hash && hash_of(scene, {rows.data(), kPoints}) == hash);
  EXPECT(hash_of(scene, {table, kPoints}) == hash && hash_of(scene, rcbd::Positions::axes(x, y, z)) == hash);
  EXPECT(hash_of(scene, rcbd::Positions::axes({&particles[0].x, &particles[0].y, &particles[0].z}, kPoints, stride)) ==
         hash);
  EXPECT(hash_of(scene, rcbd::WritablePositions(xyz)) == hash);
  EXPECT(hash_of(scene, rcbd::WritablePositions::axes(x, y, z)) == hash);
  EXPECT(hash_of(scene, rcbd::WritablePositions::axes({x.data(), y.data(), z.data()}, kPoints)) == hash);
  std::vector<float> single(xyz.begin(), xyz.end());
  scene.step(single);
  const std::vector<double> widened(single.begin(), single.end());
  EXPECT(hash_of(scene, widened) == scene.cuts().hash());
  std::vector<std::array<float, 2>> flat(kPoints);
  const rcbd::Scene plane = opened(client, "plane", 2);
  EXPECT(rcbd::Positions(flat).dims() == 2 && plane.step(flat).report().n == kPoints);
  EXPECT(plane.cuts().regions()[0].lo[2] == -INFINITY);
  const std::vector<double> nobody;
  EXPECT(opened(client, "nobody").step(nobody).report().n == 0);
}

// Into a box, by whole periods; only what is given.
void wrap() {
  std::vector<double> x = {0.25, 1.25, -0.25, 1, -1e-300}, kept = x, y(5, 7);
  rcbd::wrap({x, 1}, {0}, {1});
  EXPECT((x == std::vector<double>{0.25, 0.25, 0.75, 0, 0}));
  x = kept;
  rcbd::wrap(rcbd::WritablePositions::axes(x, y), {0, -INFINITY}, {1, INFINITY});
  EXPECT((x == std::vector<double>{0.25, 0.25, 0.75, 0, 0}) && y == std::vector<double>(5, 7));
  std::vector<std::array<float, 3>> rows = {{{3, -1, 0.5F}}};
  rcbd::wrap(rows, {0, 0, 0}, {1, 2, 4});
  EXPECT(rows[0][0] == 0 && rows[0][1] == 1 && rows[0][2] == 0.5F);
  EXPECT_ERROR(RCBD_INVALID_ARGUMENT, "", rcbd::wrap(rows, {0, 0, 0}, {1, 0, 4}));
}

// The distance from a region, in a norm. Without bounds it reaches to the box's, along periodic axes.
bool within(const std::array<double, 3>& image, const rcbd::Box& region, const rcbd::Near& near) {
  double largest = 0, squares = 0;
  for (std::size_t a = 0; a < 3; ++a) {
    const bool periodic = std::isfinite(near.periodic.lo[a]);
    const double lo = periodic ? std::max(region.lo[a], near.periodic.lo[a]) : region.lo[a];
    const double hi = periodic ? std::min(region.hi[a], near.periodic.hi[a]) : region.hi[a];
    const double distance = std::max({lo - image[a], image[a] - hi, 0.0});
    largest = std::max(largest, distance);
    squares += distance * distance;
  }
  return near.norm == rcbd::Norm::max ? largest <= near.width : squares <= near.width * near.width;
}

// The halo of each part against its definition, entry by entry.
void expect_halo(const rcbd::Cuts& cuts, const std::vector<double>& xyz, const rcbd::Near& near) {
  const std::vector<rcbd::Box> regions = cuts.regions();
  const std::vector<std::int32_t> owner = cuts.owner(xyz);
  const rcbd::Lists halo = cuts.halo(xyz, near);
  for (std::size_t q = 0; q < regions.size(); ++q) {
    const rcbd::Array<std::int64_t> items = halo.items(q);
    const rcbd::Array<std::int32_t> shifts = halo.shifts(q);
    std::size_t entry = 0;
    for (std::size_t i = 0; i < kPoints; ++i)
      for (int s = 0; s < 9; ++s) {  // periodic along x and z
        const int sx = s / 3 - 1, sz = s % 3 - 1;
        const std::array<double, 3> image{{xyz[3 * i] + sx, xyz[3 * i + 1], xyz[3 * i + 2] + sz}};
        if (!within(image, regions[q], near) || (owner[i] == static_cast<int>(q) && sx == 0 && sz == 0)) continue;
        EXPECT(entry < items.size() && items[entry] == static_cast<std::int64_t>(i));
        EXPECT(shifts[3 * entry] == sx && shifts[3 * entry + 1] == 0 && shifts[3 * entry + 2] == sz);
        ++entry;
      }
    EXPECT(entry == items.size() && entry > 50);
  }
}

void near_parts() {
  const std::vector<double> xyz = points();
  const rcbd::Client client = rcbd::connect(endpoint());
  const rcbd::Scene scene = opened(client, "near");
  rcbd::StepOptions options;
  options.want_parts = true;
  const rcbd::Array<std::int32_t> parts = scene.step(xyz, options).parts();
  const rcbd::Cuts cuts = scene.cuts();
  EXPECT(cuts.owner(xyz) == copy(parts));
  std::vector<std::int32_t> into(kPoints);
  cuts.owner(xyz, into.data());
  EXPECT(into == copy(parts));
  const rcbd::Box periodic{{{0, -INFINITY, 0}}, {{1, INFINITY, 1}}};
  expect_halo(cuts, xyz, {0.07, periodic, rcbd::Norm::max});
  expect_halo(cuts, xyz, {0.07, periodic, rcbd::Norm::euclid});
  rcbd::AskOptions ask;
  ask.seats = 2;
  EXPECT(cuts.halo(xyz, rcbd::Near{0.07}, ask).size() == 2);
  const std::vector<double> widths(kPoints, 0.07);
  ask = {};
  ask.widths = widths;
  EXPECT(cuts.halo(xyz, rcbd::Near{}, ask).entries() == cuts.halo(xyz, rcbd::Near{0.07}).entries());
  const rcbd::Lists touched = cuts.box({0.1, 0.1, 0.1}, {0.1, 0.1, 0.1});
  const std::vector<double> place(3, 0.1);
  EXPECT(touched.items().size() == 1 && touched.items()[0] == cuts.owner(place)[0]);
  const rcbd::Narrowest narrowest = cuts.narrowest(periodic);
  const auto part = static_cast<std::size_t>(narrowest.part), axis = static_cast<std::size_t>(narrowest.axis);
  const rcbd::Box region = cuts.regions().at(part);
  EXPECT(narrowest.width > 0.1 && std::min(region.hi[axis], 1.0) - std::max(region.lo[axis], 0.0) == narrowest.width);
}

}  // namespace

int main(int count, char** arguments) {
  return run_case(count, arguments,
                  {{"results", results},
                   {"answers", answers},
                   {"arrays", arrays},
                   {"last_holder", last_holder},
                   {"kinds_of_arrays", kinds_of_arrays},
                   {"wrap", wrap},
                   {"near_parts", near_parts}});
}
