// Frames of text: LAMMPS' dumps and XYZ files of many frames, from files, gzip, and streams that come in pieces.
#include <atomic>
#include <thread>

#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/stat.h>
#include <unistd.h>
#include <zlib.h>

#include "common/base/random.hpp"
#include "common/io/formats/lines.hpp"
#include "tests/common/io/files.hpp"

namespace rcb::io {
namespace {

using namespace testing;
using Column = std::vector<double>;
using Ids = std::vector<std::int64_t>;

struct Taken {
  std::vector<Points> frames;
  std::string unfinished;
  Status status;  // of the first frame that failed, or of opening
  std::string said() const { return status.message() + " | " + status.hint(); }
};

Taken all_frames(Result<std::unique_ptr<TrajectoryReader>> reader) {
  Taken taken;
  taken.status = reader.status();
  while (taken.status.ok()) {
    auto frame = reader.value()->next();
    taken.status = frame.status();
    if (!frame.ok() || !*frame) break;
    taken.frames.push_back(std::move(**frame));
  }
  if (reader.ok()) taken.unfinished = reader.value()->unfinished();
  return taken;
}

std::string gzipped(std::string_view text) {
  std::string out(text.size() + 200, '\0');
  z_stream packer{};
  EXPECT_EQ(deflateInit2(&packer, 6, Z_DEFLATED, 15 + 16, 8, Z_DEFAULT_STRATEGY), Z_OK);
  packer.next_in = reinterpret_cast<Bytef*>(const_cast<char*>(text.data()));
  packer.avail_in = static_cast<unsigned>(text.size());
  packer.next_out = reinterpret_cast<Bytef*>(out.data());
  packer.avail_out = static_cast<unsigned>(out.size());
  EXPECT_EQ(deflate(&packer, Z_FINISH), Z_STREAM_END);
  out.resize(packer.total_out);
  deflateEnd(&packer);
  return out;
}

std::string dump(int timestep, const std::string& columns, const std::vector<std::string>& rows,
                 const std::string& box = " pp pp pp\n0 10\n0 10\n0 10\n") {
  std::string text = "ITEM: TIMESTEP\n" + std::to_string(timestep) + "\nITEM: NUMBER OF ATOMS\n" +
                     std::to_string(rows.size()) + "\nITEM: BOX BOUNDS" + box + "ITEM: ATOMS " + columns + "\n";
  for (const std::string& row : rows) text += row + "\n";
  return text;
}

std::string with_crlf(const std::string& text) {
  std::string out;
  for (const char c : text) out += c == '\n' ? std::string("\r\n") : std::string(1, c);
  return out;
}

// Gives the text in pieces of random lengths.
class Pieces final : public ByteSource {
 public:
  Pieces(std::string text, std::uint64_t seed) : text_(std::move(text)), random_(seed) {}
  Result<std::size_t> read(char* to, std::size_t bytes) override {
    const std::size_t most = std::min<std::size_t>(bytes, 1 + random_.below(random_.below(2) == 0 ? 3 : 60));
    const std::size_t given = text_.copy(to, most, at_);
    at_ += given;
    return given;
  }

 private:
  std::string text_;
  Random random_;
  std::size_t at_ = 0;
};

class Frames : public ::testing::Test {
 protected:
  Taken read(std::string_view text, const ReadOptions& options = {}, std::string_view name = "run.dump") {
    return all_frames(open_trajectory(directory_.write(name, text), options));
  }
  // The only frame of a text that must be taken.
  Points good(std::string_view text, const ReadOptions& options = {}, std::string_view name = "run.dump") {
    Taken taken = read(text, options, name);
    EXPECT_TRUE(taken.status.ok()) << taken.said();
    EXPECT_EQ(taken.frames.size(), 1U) << text;
    EXPECT_EQ(taken.unfinished, "");
    return taken.frames.empty() ? Points{} : taken.frames[0];
  }
  // What is said of a text that must be refused.
  std::string bad(std::string_view text, const ReadOptions& options = {}, std::string_view name = "run.dump") {
    const Taken taken = read(text, options, name);
    EXPECT_FALSE(taken.status.ok()) << text;
    EXPECT_TRUE(has(taken.said(), name)) << taken.said();
    EXPECT_FALSE(taken.status.hint().empty()) << taken.said();
    return taken.said();
  }

  Directory directory_;
};

TEST_F(Frames, LammpsColumnsByName) {
  const Points points = good(dump(700, "id type x y z vx", {"5 1 1 2 3 9", "2 1 4 5 6 9"}));
  EXPECT_EQ(points.position, (std::vector<Column>{{1, 4}, {2, 5}, {3, 6}}));
  EXPECT_EQ(points.id, (Ids{5, 2}));
  EXPECT_EQ(points.timestep, 700);
  EXPECT_EQ(good(dump(0, "z y x", {"3 2 1"})).position, (std::vector<Column>{{1}, {2}, {3}}));
  EXPECT_EQ(good(dump(0, "id xu yu zu", {"1 11 -2 3"})).position, (std::vector<Column>{{11}, {-2}, {3}}));
  EXPECT_TRUE(good(dump(0, "type x y z", {"7 1 2 3"})).id.empty());
  EXPECT_EQ(good(dump(0, "x y z radius", {"1 2 3 0.5"}), {0, "radius"}).weight, Column{.5});
  // Wrapped before unwrapped, as they are before scaled, each axis by itself.
  EXPECT_EQ(good(dump(0, "xu x xs ysu yu zs zsu", {"11 1 0.5 9 12 0.25 9"})).position,
            (std::vector<Column>{{1}, {12}, {2.5}}));
  // Two dimensions: those that are there, or that are asked for.
  EXPECT_EQ(good(dump(0, "id x y", {"1 1 2"})).dims, 2);
  EXPECT_EQ(good(dump(0, "id x y z", {"1 1 2 0"}), {2, ""}).position, (std::vector<Column>{{1}, {2}}));
  EXPECT_TRUE(has(bad(dump(0, "id type vx vy vz", {"1 1 0 0 0"})), "no positions among the columns"));
  EXPECT_TRUE(has(bad(dump(0, "id x y", {"1 1 2"}), {3, ""}), "3 are asked for"));
}

TEST_F(Frames, LammpsScaledPositions) {
  const std::string box = " pp ff pp\n-10 10\n1e0 3\n-0.5 0.5\n";
  EXPECT_EQ(good(dump(0, "id type xs ys zs", {"1 1 0.25 0.5 1", "2 1 0 1 0"}, box)).position,
            (std::vector<Column>{{-5, -10}, {2, 3}, {.5, -.5}}));
  EXPECT_EQ(good(dump(0, "zsu xsu ysu", {"2 -1 0"}, box)).position, (std::vector<Column>{{-30}, {1}, {1.5}}));
  EXPECT_EQ(good(dump(0, "xs ys zs", {"0.25 0.5 0"}, box), {2, ""}).position, (std::vector<Column>{{-5}, {2}}));
  for (const char* skewed :
       {" xy xz yz pp pp pp\n0 12 2\n0 10 0\n0 10 0\n", " abc origin pp pp pp\n1 0 0 0\n0 1 0 0\n0 0 1 0\n"}) {
    EXPECT_EQ(good(dump(0, "x y z", {"1 2 3"}, skewed)).count, 1U);
    const std::string said = bad(dump(0, "xs ys zs", {"0 0 0"}, skewed));
    EXPECT_TRUE(has(said, "triclinic") && has(said, "scale no")) << said;
  }
  EXPECT_TRUE(has(bad("ITEM: TIMESTEP\n0\nITEM: NUMBER OF ATOMS\n1\nITEM: ATOMS xs ys zs\n0 0 0\n"), "bounds"));
  EXPECT_EQ(read(dump(0, "xs ys zs", {"1e308 0 0"}, " pp pp pp\n0 1e308\n0 1\n0 1\n")).status.code(), Code::not_finite);
}

TEST_F(Frames, LammpsOfManyFrames) {
  const std::string text = "ITEM: UNITS\nlj\nITEM: TIME\n0.5\n" + dump(0, "id x y z", {"1 1 2 3", "2 4 5 6"}) +
                           "ITEM: TIME\n1.5\n" + dump(100, "id x y z", {"2 7 8 9", "1 1 1 1", "9 2 2 2"}) +
                           dump(200, "id x y z", {}) + "\n\n";
  for (const std::string& whole : {text, with_crlf(text), "\xEF\xBB\xBF" + text}) {
    const Taken taken = read(whole);
    ASSERT_TRUE(taken.status.ok()) << taken.said();
    ASSERT_EQ(taken.frames.size(), 3U);
    EXPECT_EQ(taken.frames[1].id, (Ids{2, 1, 9}));
    EXPECT_EQ(taken.frames[1].position[2], (Column{9, 1, 2}));
    EXPECT_EQ(taken.frames[2].count, 0U);
    EXPECT_EQ(taken.frames[2].dims, 3);
    EXPECT_EQ(taken.frames[2].timestep, 200);
    EXPECT_EQ(taken.unfinished, "");
  }
}

// Whatever byte a dump ends at, the whole frames before stand, and a frame that is cut is never taken.
TEST_F(Frames, LammpsThatIsStillBeingWritten) {
  const std::string first = dump(0, "id x y z", {"1 1 2 3", "2 4 5 6"});
  const std::string second = dump(100, "id x y z", {"1 1 2 35", "2 4 5 65"});
  for (std::size_t length = 0; length <= second.size(); ++length) {
    const Taken taken = read(first + second.substr(0, length));
    EXPECT_TRUE(taken.status.ok()) << taken.said();
    EXPECT_EQ(taken.frames.size(), length == second.size() ? 2U : 1U) << length;
    EXPECT_EQ(taken.unfinished.empty(), length == 0 || length == second.size()) << taken.unfinished;
  }
  const Taken taken = read(first + second.substr(0, second.size() - 1));
  EXPECT_TRUE(has(taken.unfinished,
                  "run.dump: ends within frame 1 (timestep 100), which begins in line 12, after 1 of "
                  "its 2 rows"))
      << taken.unfinished;
}

TEST_F(Frames, LammpsFaultsAreNamed) {
  const std::string first = dump(0, "id x y z", {"1 1 2 3"});
  const auto said = [&](const std::string& second) {
    const Taken taken = read(first + second);
    EXPECT_EQ(taken.frames.size(), 1U);
    EXPECT_FALSE(taken.status.ok());
    return taken.said();
  };
  EXPECT_TRUE(has(said(dump(5, "id x y z", {"1 1 2 3", "2 1 2"})),
                  "run.dump:21: frame 1 (timestep 5): row 2 has 3 columns, but ITEM: ATOMS names 4"));
  EXPECT_TRUE(has(said(dump(5, "id x y z", {"1 1 nan 3"})), "run.dump:20: column 3 (y): 'nan' is not a finite number"));
  EXPECT_TRUE(has(said(dump(5, "id x y z", {"-1 1 1 3"})), "is not an id"));
  EXPECT_TRUE(has(said(dump(5, "id x y z", {"7 1 1 3", "8 1 1 1", "7 0 0 0"})), "id 7 stands in its rows 1 and 3"));
  EXPECT_TRUE(has(said("ITEM: NUMBER OF ATOMS\n2\nITEM: ATOMS x y z\n1 2 3\n" + first), "has 1 rows, 2 are announced"));
  EXPECT_TRUE(has(said("1 2 3\n"), "run.dump:11: frame 1: '1 2 3' where a line \"ITEM: ...\" should begin"));
  EXPECT_TRUE(has(said("ITEM: TIMESTEP\nx\n"), "'x' is no timestep"));
  EXPECT_TRUE(has(said("ITEM: NUMBER OF ATOMS\n-1\n"), "'-1' is no number of atoms"));
  EXPECT_TRUE(has(said("ITEM: NUMBER OF ATOMS\n99999999999999999999\n"), "is no number of atoms"));
  EXPECT_TRUE(has(said("ITEM: ATOMS id x y z\n"), "without ITEM: NUMBER OF ATOMS"));
  EXPECT_TRUE(has(said("ITEM: BOX BOUNDS pp pp pp\n0 1\n0\n"), "'0' are no bounds"));
  EXPECT_TRUE(has(said("ITEM: BOX BOUNDS pp pp pp\n0 inf\n"), "no bounds"));
  EXPECT_TRUE(has(said("ITEM: TIMESTEP\n1\nITEM: NUMBER OF ENTRIES\n"), "a dump without atoms"));
}

// A count is no reason to take memory, nor a line without an end.
TEST_F(Frames, HostileCountsAndLines) {
  std::string text = dump(0, "id x y z", {"1 1 2 3"});
  text.replace(text.find("ATOMS\n1"), 7, "ATOMS\n1000000000000000000");
  const Taken taken = read(text);
  EXPECT_TRUE(has(taken.unfinished, "after 1 of its 1000000000000000000 rows")) << taken.unfinished;
  for (const std::string& start : {std::string("ITEM: TIMESTEP\n0\nITEM: "), dump(0, "x", {"1"}), std::string("3\nc\n"),
                                   std::string("3\nc\n1 2 3\n")}) {
    const std::string said = bad(start + std::string(3U << 20U, '5'), {}, "long.xyz");
    EXPECT_TRUE(has(said, "a line of more than") || has(said, "count line says 3")) << said;
  }
  EXPECT_TRUE(has(bad("18446744073709551615\nc\nA 1 2 3\n", {}, "a.xyz"), "it has 1"));
}

TEST_F(Frames, XyzOfManyFrames) {
  const std::string text =
      "2\nfirst\nA 1 2 3\nB 4 5 6\n\n3\nProperties=id:I:1:pos:R:3 t=1\n7 1 1 1\n5 2 2 2\n6 3 3 3\n0\nnone\n1\n\nA 9 9 "
      "9\n";
  for (const std::string& whole : {text, with_crlf(text), "\xEF\xBB\xBF" + text}) {
    const Taken taken = read(whole, {}, "run.xyz");
    ASSERT_TRUE(taken.status.ok()) << taken.said();
    ASSERT_EQ(taken.frames.size(), 4U);
    EXPECT_EQ(taken.frames[0].position, (std::vector<Column>{{1, 4}, {2, 5}, {3, 6}}));
    EXPECT_EQ(taken.frames[1].id, (Ids{7, 5, 6}));
    EXPECT_EQ(taken.frames[2].count, 0U);
    EXPECT_EQ(taken.frames[3].position[0], Column{9});
    EXPECT_FALSE(taken.frames[3].timestep);
  }
  EXPECT_EQ(read("1\n\nA 1 2 3\n1\n\nA 1 2 3\n", {}, "noname").frames.size(), 2U);
}

TEST_F(Frames, XyzThatIsCutOrWrong) {
  const std::string first = "2\nc\nA 1 2 3\nB 4 5 6\n", second = "2\nc\nA 1 2 35\nB 4 5 65\n";
  for (std::size_t length = 0; length <= second.size(); ++length) {
    const Taken taken = read(first + second.substr(0, length), {}, "run.xyz");
    EXPECT_TRUE(taken.status.ok()) << taken.said();
    EXPECT_EQ(taken.frames.size(), length == second.size() ? 2U : 1U) << length;
    EXPECT_EQ(taken.unfinished.empty(), length == 0 || length == second.size()) << taken.unfinished;
  }
  EXPECT_TRUE(has(bad(first + "C 7 8 9\n" + second, {}, "run.xyz"), "the frame before has 2"));
  EXPECT_TRUE(has(bad(first + "2\nc\nA 1 2 3\n" + second, {}, "run.xyz"),
                  "run.xyz:8: frame 1: row 2 has 1 column, but the frame's first row has 4"));
  EXPECT_TRUE(has(bad(first + "1\nc\nA 1 x 3\n", {}, "run.xyz"), "run.xyz:7: column 3 (y): 'x' is not a number"));
  // What is wrong with a single frame is said as of other text.
  EXPECT_TRUE(has(bad("3\nc\nAr 1 2 3\n", {}, "a.xyz"), "says 3 rows, it has 1"));
  EXPECT_EQ(good("2\n\n18 1 2 3\n18 4 5 6", {}, "a.xyz").count, 2U);
}

TEST_F(Frames, InPiecesOfAnyLength) {
  const std::string lammps = dump(0, "id x y z", {"1 1 2 3", "2 4.25 5 6"}) + dump(10, "id x y z", {"2 7 8 9"});
  const std::string xyz = "2\nfirst\nA 1 2 3\nB 4.25 5 6\n1\n\nA 7 8 9\n";
  for (std::uint64_t seed = 0; seed < 60; ++seed) {
    SCOPED_TRACE(seed);
    const bool packed = seed % 3 == 0;
    const std::string text = seed % 2 == 0 ? with_crlf(lammps) : xyz;
    std::unique_ptr<ByteSource> source = std::make_unique<Pieces>(packed ? gzipped(text) : text, seed);
    if (packed) source = unpacked("stream", std::move(source));
    LineReader lines({.name = "stream", .is_stream = true, .packed = packed, .bytes = std::move(source)});
    const Taken taken = all_frames(seed % 2 == 0 ? read_lammps(std::move(lines), {}) : read_xyz(std::move(lines), {}));
    ASSERT_TRUE(taken.status.ok()) << taken.said();
    ASSERT_EQ(taken.frames.size(), 2U);
    EXPECT_EQ(taken.frames[0].position, (std::vector<Column>{{1, 4.25}, {2, 5}, {3, 6}}));
    EXPECT_EQ(taken.frames[1].position, (std::vector<Column>{{7}, {8}, {9}}));
  }
}

TEST_F(Frames, GzipOfEveryText) {
  const std::string csv = "x,y,id\n1,2,7\n3,4,5\n";
  Points points = good(gzipped(csv), {}, "p.csv.gz");
  EXPECT_EQ(points.position, (std::vector<Column>{{1, 3}, {2, 4}}));
  EXPECT_EQ(points.id, (Ids{7, 5}));
  // Of several members, as `cat a.gz b.gz` makes them; padded with zeros, as on tapes.
  EXPECT_EQ(good(gzipped("1 2\n3") + gzipped("") + gzipped(" 4\n") + std::string(512, '\0'), {}, "p.gz").position,
            (std::vector<Column>{{1, 3}, {2, 4}}));
  EXPECT_EQ(read(gzipped(dump(0, "x y", {"1 2"}) + dump(1, "x y", {"1 2"}))).frames.size(), 2U);
  EXPECT_EQ(good(gzipped("1\n\nA 1 2 3\n"), {}, "p.xyz.gz").count, 1U);
  EXPECT_EQ(good(gzipped(npy({1, 2}, {4, 5}, {})), {}, "p.npy.gz").position, (std::vector<Column>{{4}, {5}}));
  EXPECT_EQ(read(gzipped(npy({3, 1, 2}, {1, 2, 3, 4, 5, 6}, {})), {}, "p.npy.gz").frames.size(), 3U);
  EXPECT_TRUE(has(bad(gzipped("[[1,2]]\n"), {}, "p.json.gz"), "is JSON"));
  EXPECT_TRUE(has(bad(gzipped("x,y\n1,a\n"), {}, "p.csv.gz"), "p.csv.gz:2: column 2 (y): 'a' is not a number"));
  // By the ranks' way of reading it can't be had.
  EXPECT_TRUE(has(refusal(read_points_slice(directory_.write("p.csv.gz", gzipped(csv)), {}, 0, 2)), "in slices"));
  EXPECT_TRUE(
      has(refusal(read_points_slice(directory_.write("a.dump", dump(0, "x", {"1"})), {}, 0, 2)), "LAMMPS dump"));
}

TEST_F(Frames, GzipThatIsCutOrDamaged) {
  const std::string packed = gzipped("x,y,id\n1,2,7\n3,4,5\n");
  for (std::size_t length = 2; length < packed.size(); ++length)
    EXPECT_TRUE(has(bad(packed.substr(0, length), {}, "p.csv.gz"), "end too early")) << length;
  for (std::size_t byte = 10; byte < packed.size(); ++byte) {
    std::string damaged = packed;
    damaged[byte] = static_cast<char>(damaged[byte] ^ 0x10);
    const Taken taken = read(damaged, {}, "p.csv.gz");
    const bool told = has(taken.said(), "damaged") || has(taken.said(), "end too early");
    // A few bits fill a byte up and mean nothing.
    EXPECT_TRUE(told || (taken.status.ok() && taken.frames[0].position == good(packed, {}, "p.csv.gz").position))
        << byte << taken.said();
  }
  EXPECT_TRUE(has(bad(packed + "xyz", {}, "p.csv.gz"), "damaged"));
  // The frames before the end stand.
  const std::string frames = gzipped(dump(0, "x y", {"1 2"})) + gzipped(dump(1, "x y", {"1 2"}));
  const Taken taken = read(frames.substr(0, frames.size() - 1));
  EXPECT_FALSE(taken.status.ok());
  EXPECT_GE(taken.frames.size(), 1U);
}

class Fifo : public Frames {
 protected:
  void SetUp() override { ASSERT_EQ(::mkfifo(path_.c_str(), 0600), 0); }
  // Waits until a reader has opened it.
  int open_to_write() const { return ::open(path_.c_str(), O_WRONLY); }
  static void put(int fifo, const std::string& text) {
    EXPECT_EQ(::write(fifo, text.data(), text.size()), static_cast<ssize_t>(text.size()));
  }

  const std::string path_ = directory_ / "run.fifo";
};

// A frame is given as soon as its last row has come, while its writer waits.
TEST_F(Fifo, FramesComeAsTheyAreWritten) {
  std::atomic<int> seen{0};
  std::thread writer([&] {
    const int fifo = open_to_write();
    for (int k = 0; k < 3; ++k) {
      while (seen < k) std::this_thread::yield();
      const std::string text = dump(k, "id x y", {"1 1 2", "2 3 4"});
      put(fifo, text.substr(0, 40));
      put(fifo, text.substr(40));
    }
    while (seen < 3) std::this_thread::yield();
    ::close(fifo);
  });
  const auto reader = open_frames(path_, {}, FrameFormat::lammps);
  EXPECT_TRUE(reader.ok()) << refusal(reader);
  for (int k = 0; k < 3; ++k) {
    const auto frame = reader.value()->next();
    EXPECT_TRUE(frame.ok() && frame->has_value() && (**frame).timestep == k) << refusal(frame);
    ++seen;
  }
  EXPECT_FALSE(reader.value()->next()->has_value());
  writer.join();
}

TEST_F(Fifo, EndsWithinAFrame) {
  const std::string text = dump(0, "x y", {"1 2"}) + dump(1, "x y", {"1 2", "3 4"});
  std::thread writer([&] {
    const int fifo = open_to_write();
    put(fifo, text.substr(0, text.size() - 2));
    ::close(fifo);
  });
  const Taken taken = all_frames(open_trajectory(path_, {}));
  writer.join();
  EXPECT_EQ(taken.frames.size(), 1U);
  EXPECT_TRUE(has(taken.said(), "ends within frame 1 (timestep 1)")) << taken.said();
}

TEST_F(Fifo, OtherFormatsAreReadWhole) {
  for (const std::string& text : {std::string("x,y\n1,2\n"), npy({1, 2}, {1, 2}, {}), gzipped("1 2\n")}) {
    std::thread writer([&] {
      const int fifo = open_to_write();
      put(fifo, text);
      ::close(fifo);
    });
    const Taken taken = all_frames(open_trajectory(path_, {}));
    writer.join();
    ASSERT_EQ(taken.frames.size(), 1U) << taken.said();
    EXPECT_EQ(taken.frames[0].position, (std::vector<Column>{{1}, {2}}));
  }
}

TEST_F(Fifo, AWaitIsToldAndCanBeGivenUp) {
  std::atomic<bool> stop{false};
  int told = 0;
  ReadOptions options;
  options.stop = &stop;
  options.on_wait = [&](double) { stop = ++told == 2; };
  EXPECT_EQ(open_trajectory(path_, options).status().code(), Code::aborted);
  EXPECT_EQ(told, 2);
}

}  // namespace
}  // namespace rcb::io
