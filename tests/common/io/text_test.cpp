// CSV, other text and XYZ: what is taken, and what each refusal says.
#include <chrono>
#include <thread>

#include <gtest/gtest.h>
#include <sys/stat.h>

#include "tests/common/io/files.hpp"

namespace rcb::io {
namespace {

using namespace testing;
using Column = std::vector<double>;

class Text : public ::testing::Test {
 protected:
  Result<Points> read(std::string_view text, const ReadOptions& options = {}, std::string_view name = "points.csv") {
    path_ = directory_.write(name, text);
    auto points = read_points(path_, options);
    // Any number of readers have the same rows.
    if (points.ok()) {
      for (const int of : {2, 3, 7, 40}) expect_same(joined(path_, options, of), *points);
    }
    return points;
  }
  Points good(std::string_view text, const ReadOptions& options = {}, std::string_view name = "points.csv") {
    auto points = read(text, options, name);
    EXPECT_TRUE(points.ok()) << refusal(points) << "\n" << text;
    return points.ok() ? *points : Points{};
  }
  std::string bad(std::string_view text, const ReadOptions& options = {}, std::string_view name = "points.csv") {
    const auto points = read(text, options, name);
    EXPECT_FALSE(points.ok()) << text;
    EXPECT_TRUE(has(refusal(points), name)) << refusal(points);
    if (!points.ok()) {
      EXPECT_FALSE(points.status().hint().empty()) << refusal(points);
    }
    return refusal(points);
  }

  Directory directory_;
  std::string path_;
};

TEST_F(Text, EverySeparator) {
  for (const char* text : {"1,2\n3,4\n", "1;2\n3;4\n", "1 2\n3 4\n", "1\t2\n3\t4\n", " 1 ,\t2 \n3,4",
                           "  1   2  \n3 \t 4\n", "1,2,\n3,4,\n", "\"1\",\"2\"\n\"3\",\"4\"\n"}) {
    const Points points = good(text);
    ASSERT_EQ(points.dims, 2) << text;
    EXPECT_EQ(points.position[0], (Column{1, 3})) << text;
    EXPECT_EQ(points.position[1], (Column{2, 4})) << text;
    EXPECT_TRUE(points.id.empty());
  }
}

TEST_F(Text, EveryNumberSyntax) {
  const Points points = good("-.5\n1e3\n+2\n5.\n.25\n-0\n1E-2\n1.5D+02\n1d1\n007\n1e-400\n4.9e-324\n0.1\n");
  EXPECT_EQ(points.position[0], (Column{-.5, 1000, 2, 5, .25, 0, .01, 150, 10, 7, 0, 4.9e-324, 0.1}));
}

TEST_F(Text, ColumnsByName) {
  Points points = good("ID,z,mass,Y,x\n7,3,9,2,1\n5,6,9,5,4\n");
  EXPECT_EQ(points.dims, 3);
  EXPECT_EQ(points.position, (std::vector<Column>{{1, 4}, {2, 5}, {3, 6}}));
  EXPECT_EQ(points.id, (std::vector<std::int64_t>{7, 5}));
  EXPECT_TRUE(points.weight.empty());
  points = good("x,y,id\n1,2,3\n");
  EXPECT_EQ(points.dims, 2);
  points = good("x y name z\n1 2 abc 3\n", {2, ""});
  EXPECT_EQ(points.position, (std::vector<Column>{{1}, {2}}));
  points = good("x,y,comment\n1,2,\"a, b\"\n3,4,\n");
  EXPECT_EQ(points.position, (std::vector<Column>{{1, 3}, {2, 4}}));
  // As ParaView writes them, beside its other arrays.
  for (const char* header :
       {"\"part\",\"Points:0\",\"Points:1\",\"Points:2\"\n", "part,Points_0,Points_1,Points_2\n"}) {
    points = good(std::string(header) + "9,1,2,3\n");
    EXPECT_EQ(points.position, (std::vector<Column>{{1}, {2}, {3}})) << header;
  }
  EXPECT_EQ(good("Points:0,Points:1,x\n1,2,3\n").position, (std::vector<Column>{{3}}));
  EXPECT_EQ(good("X [m],Y (mm),id\n1,2,3\n").position, (std::vector<Column>{{1}, {2}}));
  EXPECT_EQ(good("y,z\n1,2\n").position, (std::vector<Column>{{1}, {2}}));
}

TEST_F(Text, NamesThatAreNotOfAxesAreRefused) {
  for (const char* header : {"Rank,t[s],vx", "a,b,c", "lon,lat,z", "r,z,p", "id,posx,posy", "x[0],x[1],x[2]"}) {
    for (const int dims : {0, 2}) {
      const std::string said = bad(std::string(header) + "\n1,2,3\n", {dims, ""});
      EXPECT_TRUE(has(said, "its columns are named ") && has(said, "say with --columns")) << said;
      EXPECT_FALSE(has(said, "--dims")) << said;
    }
  }
  EXPECT_TRUE(has(bad("Rank,t[s],vx\n1,2,3\n"), "its columns are named Rank, t[s], vx, not x, y and z"));
}

ReadOptions columns(std::vector<std::string> names, std::string ids = "", std::string weights = "") {
  return {.weights = std::move(weights), .columns = std::move(names), .ids = std::move(ids)};
}

TEST_F(Text, ColumnsThatAreAskedFor) {
  const char* named = "tag;a;B;w;x\n4;1;2;3;9\n";
  for (const auto& axes : {std::vector<std::string>{"B", "a"}, {"b", "A"}, {"2", "1"}}) {
    const Points points = good(named, columns(axes, "tag", "w"));
    EXPECT_EQ(points.position, (std::vector<Column>{{2}, {1}}));
    EXPECT_EQ(points.id, std::vector<std::int64_t>{4});
    EXPECT_EQ(points.weight, Column{3});
  }
  EXPECT_EQ(good(named, columns({}, "0")).position, (std::vector<Column>{{9}}));
  EXPECT_EQ(good("7 1 2\n", columns({}, "0")).position, (std::vector<Column>{{1}, {2}}));
  EXPECT_EQ(good("7 1 2\n", columns({}, "0")).id, std::vector<std::int64_t>{7});
  EXPECT_EQ(good("1 2 3 4 5\n", columns({"4", "0"})).position, (std::vector<Column>{{5}, {1}}));
  EXPECT_EQ(good("id,x,y\n1,2,3\n", columns({"x"}, "y")).id, std::vector<std::int64_t>{3});
  EXPECT_EQ(good("1\n\nH 1 2 3 0.5 0.5 7\n", columns({"z", "1", "2"}, "6"), "a.xyz").position,
            (std::vector<Column>{{3}, {1}, {2}}));
  EXPECT_TRUE(
      has(bad(named, columns({"a", "c"})), "no column 'c' for the positions | the columns are tag, a, B, w, x"));
  EXPECT_TRUE(has(bad(named, columns({"a"}, "c")), "no column 'c' for the ids"));
  EXPECT_TRUE(has(bad("1 2\n", columns({"0", "2"})), "no column '2'"));
  EXPECT_TRUE(has(bad("q,q,x\n1,2,3\n", columns({"q"})), "two columns are named 'q' | give the number of one"));
  EXPECT_TRUE(has(bad("x,y\n1,2\n", columns({}, "x")), "can't be both ids and positions"));
  for (const auto& axes : {std::vector<std::string>{"0", "0"}, {"0", "1", "2", "3"}})
    EXPECT_FALSE(read("1 2 3 4\n", columns(axes)).ok());
  EXPECT_TRUE(has(bad("1 2 3\n", {.dims = 3, .columns = {"0", "1"}}), "in 3 dimension"));
  EXPECT_TRUE(has(bad("id,x\n1.5,2\n"), "--ids says which column holds them"));
}

TEST_F(Text, NamesInAComment) {
  // Each as wide as three columns.
  for (const char* comment :
       {"# id x y", "#id,x,y", "# id, x, y", "# id\tx\ty", "#  ID  X  Y  ", "# \"id\" \"x\" \"y\"", "## id;x;y",
        "# columns: id x y", "# id (1) x [m] y [m]", "# id x y\n# made by hand", "# my grains\n#\n# id x y\n\n"}) {
    for (const char* rows : {"4 1 2\n", "4,1,2\n", "4;1;2\n"}) {
      const Points points = good(std::string(comment) + "\n" + rows);
      EXPECT_EQ(points.position, (std::vector<Column>{{1}, {2}})) << comment;
      EXPECT_EQ(points.id, std::vector<std::int64_t>{4}) << comment;
    }
  }
  EXPECT_EQ(good("#z,y,x\n1,2,3\n").position, (std::vector<Column>{{3}, {2}, {1}}));
  EXPECT_EQ(good("#\tx\ty\n1\t2\t3\n").position, (std::vector<Column>{{2}, {3}}));
  EXPECT_EQ(good("# tag a b\n4 1 2\n", columns({"b", "a"}, "tag")).position, (std::vector<Column>{{2}, {1}}));
  EXPECT_EQ(good("# Rank t[s] vx\n4 1 2\n", columns({"1", "2"})).position, (std::vector<Column>{{1}, {2}}));
  for (const char* comment : {"# Rank t[s] vx", "# vx vy vz", "# id posx posy", "# lon,lat,alt", "# mass radius foo_1",
                              "# number of grains\n# foo,bar,baz", "#1:rank 2:vx 3:vy"})
    EXPECT_TRUE(has(bad(std::string(comment) + "\n1 2 3\n"), "say with --columns")) << comment;
}

TEST_F(Text, ACommentThatIsASentenceSaysNothing) {
  for (const char* comment :
       {"# made by hand", "# dam break, coarse", "# Particle positions [m]", "# t = 0.5", "# step 100 x",
        "# the x axis", "# LIGGGHTS v3.8 run", "# two colliding spheres", "# 2024-01-02 12:00:00 UTC", "# Smith et al.",
        "# x y", "# x y z w", "# nothing", "#", "# t=0 dt=1 n=5", "# see http://x.org/y now"}) {
    const Points points = good(std::string(comment) + "\n1 2 3\n");
    EXPECT_EQ(points.position, (std::vector<Column>{{1}, {2}, {3}})) << comment;
    EXPECT_TRUE(points.id.empty()) << comment;
  }
}

TEST_F(Text, ARowThatBeginsLikeACommentIsNotLost) {
  for (const char* row : {"#N/A,2,3", "#DIV/0!,2,3", "#,2,3", "#REF!", "########,2,3", "#no blank"}) {
    const std::string said = bad("x,y,z\n1,2,3\n" + std::string(row) + "\n4,5,6\n");
    EXPECT_TRUE(has(said, "points.csv:3: ") && has(said, "needs a blank behind its #")) << said;
  }
  for (const char* begin : {"", "x,y,z\n"})
    EXPECT_TRUE(has(bad(std::string(begin) + "#N/A,2,3\n4,5,6\n"), "is not a number")) << begin;
  EXPECT_EQ(good("x,y\n#m,m\n1,2\n# c\n#\n#\tc\r\n3,4\n").count, 2U);
  EXPECT_EQ(good("name,x\n#N/A,2\nb,3\n").count, 2U);
}

TEST_F(Text, FirstLinesThatAreNoRow) {
  EXPECT_TRUE(has(bad("sep=;\nx;y\n1;2\n"), "its first line, sep=, is for Excel alone"));
  EXPECT_TRUE(has(bad("2\n1,2,3\n4,5,6\n"), "its first line is one number alone, before rows of 3 columns"));
  EXPECT_TRUE(has(bad("3\n1 2 3\n4 5 6\n7 8 9\n", {}, "a.txt"), "a.txt:2: is a row, where XYZ has a comment"));
  EXPECT_TRUE(has(bad("1,5\t2,5\n1,5\t3,5\n"), "its numbers have decimal commas"));
  EXPECT_TRUE(has(bad("x\ty\n1,5\t2,5\n"), "'1,5' is not a number | write numbers with a decimal point"));
  EXPECT_TRUE(has(bad("1 2 3 4 5\n6 7 8 9 0\n1 2 3 4 5\n"), "transpose it"));
}

TEST_F(Text, AFirstRowOfBrokenNumbersIsNoHeader) {
  for (const char* row : {"****,****", "\u22121.5,\u22122", "- 1.5,- 2", "\u00A01.5,\u00A02.5", "N/A,N/A",
                          "\uFEFF\uFEFF1.5,2", "-.,-.", "\033[31m1.5,\0332.5", "na,NULL"})
    EXPECT_TRUE(has(bad(std::string(row) + "\n1,2\n"), "is not a number")) << row;
  EXPECT_TRUE(has(bad("\u00E9tendue,_b\n1,2\n"), ", _b, not x, y and z"));
}

TEST_F(Text, IdsAreReadDigitByDigit) {
  EXPECT_EQ(good("x,id\n1,9007199254740991.0\n2,17.0\n3,1.5e1\n4,0.0\n5,120e-1\n6,1.8D1\n7,+5.\n").id,
            (std::vector<std::int64_t>{9007199254740991, 17, 15, 0, 12, 18, 5}));
  for (const char* id : {"0.99999999999999999999", "9007199254740993.0", "1.5", "1e16", "15e-1", "1e-400", "-1.0"})
    EXPECT_TRUE(has(bad("x,id\n1," + std::string(id) + "\n"), "is not an id")) << id;
}

TEST_F(Text, WeightsByNumberAndName) {
  EXPECT_EQ(good("5,1,2\n", {0, "0"}).position, (std::vector<Column>{{1}, {2}}));
  EXPECT_EQ(good("5,1,2\n", {0, "0"}).weight, Column{5});
  EXPECT_EQ(good("x,y,mass\n1,2,5\n", {0, "mass"}).weight, Column{5});
  EXPECT_EQ(good("1,2,3,4,5\n", {2, "0"}).position, (std::vector<Column>{{2}, {3}}));
  EXPECT_TRUE(has(bad("1,2\n", {0, "2"}), "no column '2'"));
  EXPECT_TRUE(has(bad("x,y\n1,2\n", {0, "mass"}), "the columns are x, y"));
  const std::string negative = bad("x,w\n1,2\n1,-2\n", {0, "w"});
  EXPECT_TRUE(has(negative, "points.csv:3: column 2 (w): the weight '-2' is negative")) << negative;
}

TEST_F(Text, CommentsBlankLinesAndForeignEnds) {
  const Points points =
      good("\xEF\xBB\xBF# made by hand\r\n\r\nx,y\r\n# more\r\n1,2\r\n   \r\n  # last\r\n3,4\r\n\r\n");
  EXPECT_EQ(points.position, (std::vector<Column>{{1, 3}, {2, 4}}));
}

TEST_F(Text, NoPoints) {
  EXPECT_EQ(good("").count, 0U);
  EXPECT_EQ(good("").dims, 3);
  EXPECT_EQ(good("# nothing\n\n", {2, ""}).dims, 2);
  EXPECT_EQ(good("x,y\n").count, 0U);
  EXPECT_EQ(good("x,y").dims, 2);
}

TEST_F(Text, DimsRule) {
  EXPECT_EQ(good("1\n2\n").dims, 1);
  EXPECT_EQ(good("1 2 3\n").dims, 3);
  EXPECT_EQ(good("1 2 3 4\n", {2, ""}).position, (std::vector<Column>{{1}, {2}}));
  EXPECT_EQ(good("1 2 3 4\n", {0, "3"}).dims, 3);
  EXPECT_TRUE(has(bad("1 2 3 4\n1 2 3 4\n1 2 3 4\n1 2 3 4\n"), "--columns 0,1,2"));
  EXPECT_TRUE(has(bad("1,2\n", {3, ""}), "has 2 columns of positions, 3 are asked for"));
  EXPECT_TRUE(has(bad("x,y,z,x\n1,2,3,4\n"), "two columns are named 'x'"));
  EXPECT_FALSE(read("1,2\n", {4, ""}).ok());
}

TEST_F(Text, RaggedRowsAreNamedByLine) {
  EXPECT_TRUE(has(bad("x,y\n1,2\n\n# c\n3\n"), "points.csv:5: 1 column, but the file's first line has 2"));
  EXPECT_TRUE(has(bad("1,2\n3,4,5\n"), "points.csv:2: 3 columns"));
  EXPECT_TRUE(has(bad("1 2\n3 4 5\n"), "points.csv:2: 3 columns"));
  EXPECT_TRUE(has(bad("1 2\n3\n"), "points.csv:2: 1 column"));
  EXPECT_TRUE(has(bad("1,2,3\n1,2,\n"), "points.csv:2: 2 columns"));
  EXPECT_TRUE(has(bad("1,2,3\n1,,3\n"), "points.csv:2: column 2: '' is not a number"));
}

TEST_F(Text, WhatIsNoFiniteNumberIsNamed) {
  EXPECT_TRUE(has(bad("x,y\n1,2\n1,nan\n"), "points.csv:3: column 2 (y): 'nan' is not a finite number"));
  EXPECT_EQ(read("1\ninf\n").status().code(), Code::not_finite);
  EXPECT_EQ(read("1\n-Infinity\n").status().code(), Code::not_finite);
  EXPECT_EQ(read("1\n1e999\n").status().code(), Code::not_finite);
  EXPECT_EQ(read("nan\n1\n").status().code(), Code::not_finite);
  EXPECT_TRUE(has(bad("1.0,2.0\n1.0,2.o\n"), "points.csv:2: column 2: '2.o' is not a number"));
  EXPECT_TRUE(has(bad("1.0,2.o\n1.0,2.0\n"), "points.csv:1: column 2: '2.o' is not a number"));
  EXPECT_TRUE(has(bad("1,5;2,5\n1;2\n"), "points.csv:1: column 1: '1,5' is not a number"));
  for (const char* text : {"1\n0x10\n", "1\n1e\n", "1\n+-5\n", "1\n--5\n", "1\n.\n", "1\n-\n", "1\n1.2.3\n"}) bad(text);
  EXPECT_TRUE(has(bad(std::string_view("1\n\x01\0\xFF\n", 6)), "\\x01\\x00\\xff"));
}

TEST_F(Text, Ids) {
  EXPECT_EQ(good("x,id\n1,9223372036854775807\n2,0\n3,+4\n4,5.0\n5,1e3\n").id,
            (std::vector<std::int64_t>{9223372036854775807, 0, 4, 5, 1000}));
  EXPECT_TRUE(has(bad("x,id\n1,2\n1,-3\n"), "points.csv:3: column 2 (id): '-3' is not an id"));
  for (const char* text :
       {"x,id\n1,9223372036854775808\n", "x,id\n1,1.5\n", "x,id\n1,a\n", "x,id\n1,nan\n", "x,id\n1,1e18\n"}) {
    EXPECT_TRUE(has(bad(text), "is not an id")) << text;
  }
  // Slices leave duplicates to the caller, so only the whole is asked here.
  const auto twice = read_points(directory_.write("p.csv", "x,id\n1,5\n# c\n2,6\n3,5\n4,6\n"), {});
  EXPECT_TRUE(has(refusal(twice), "p.csv:5: id 5 stands in line 2 already")) << refusal(twice);
}

TEST_F(Text, SlicesHaveTheirLineNumbersFromTheWholeFile) {
  std::string text = "x,y\n";
  for (int i = 0; i < 5000; ++i) text += i == 4321 ? "7,oops\n" : "1.25,2\n";
  const std::string path = directory_.write("p.csv", text);
  const std::string whole = refusal(read_points(path, {}));
  EXPECT_TRUE(has(whole, "p.csv:4323: column 2 (y): 'oops'")) << whole;
  int failures = 0;
  for (int k = 0; k < 8; ++k) {
    const auto slice = read_points_slice(path, {}, k, 8);
    if (slice.ok()) continue;
    ++failures;
    EXPECT_EQ(refusal(slice), whole);
  }
  EXPECT_EQ(failures, 1);
}

TEST_F(Text, HeadAndLinesLongerThanABlock) {
  std::string text;
  for (int i = 0; i < 4000; ++i) text += "# a comment that makes the head of this file long, line after line\n";
  text += "x,name\n1," + std::string(300000, 'a') + "\n2,b\n3,c\n";
  EXPECT_EQ(good(text).position[0], (Column{1, 2, 3}));
}

TEST_F(Text, Xyz) {
  const char* atoms = "3\na comment\nAr 1 2 3\nAr 4 5 6\nHe 7 8 9\n";
  for (const char* name : {"a.xyz", "a.txt", "a"}) {
    const Points points = good(atoms, {}, name);
    EXPECT_EQ(points.position, (std::vector<Column>{{1, 4, 7}, {2, 5, 8}, {3, 6, 9}}));
  }
  EXPECT_EQ(good("2\n\n18 1 2 3\n18 4 5 6", {2, ""}, "a.xyz").position, (std::vector<Column>{{1, 4}, {2, 5}}));
  EXPECT_EQ(good("1\n\n1 2 3\n", {}, "a.xyz").position, (std::vector<Column>{{1}, {2}, {3}}));
  EXPECT_EQ(good("1\n\nH 1 2 3 0.5 0.5 0.5\n", {}, "a.xyz").dims, 3);
  EXPECT_EQ(good("0\n\n", {}, "a.xyz").count, 0U);
  EXPECT_EQ(good("0", {}, "a.xyz").count, 0U);
  const Points extended = good(
      "2\nLattice=\"1 0 0\" Properties=id:I:1:species:S:1:vel:R:3:pos:R:3:q:R:1 t=0\n"
      "8 H 9 9 9 1 2 3 0.5\n6 H 9 9 9 4 5 6 0.25\n",
      {0, "q"}, "a.xyz");
  EXPECT_EQ(extended.position, (std::vector<Column>{{1, 4}, {2, 5}, {3, 6}}));
  EXPECT_EQ(extended.id, (std::vector<std::int64_t>{8, 6}));
  EXPECT_EQ(extended.weight, (Column{.5, .25}));
  for (const char* properties : {"species:S:1:pos:R:3:q:R:1", "pos:R:3", "species:S:1:pos:R", "x", ""})
    EXPECT_TRUE(
        has(bad("1\nProperties=" + std::string(properties) + "\nH 1 2 3\n", {}, "a.xyz"), "a.xyz:2: its Properties"))
        << properties;
  EXPECT_TRUE(has(bad("1\nProperties=species:S:1:vel:R:3\nH 1 2 3\n", {}, "a.xyz"), "vel:0, vel:1, vel:2, not x"));
  // A cloud of points that is only named so, and one column of numbers that begins with a whole one.
  EXPECT_EQ(good("1 2 3\n4 5 6\n", {}, "cloud.xyz").count, 2U);
  EXPECT_EQ(good("2\n3\n4\n", {}, "column.txt").position, (std::vector<Column>{{2, 3, 4}}));
}

TEST_F(Text, XyzThatIsCutOrHasSeveralFrames) {
  EXPECT_TRUE(has(bad("3\nc\nAr 1 2 3\nAr 4 5 6\n", {}, "a.xyz"), "says 3 rows, it has 2"));
  EXPECT_TRUE(has(bad("1\nc\nAr 1 2 3\n1\nc\nAr 4 5 6\n", {}, "a.xyz"), "a.xyz:4: more rows than the 1"));
  EXPECT_TRUE(has(bad("99999999999999\nc\nAr 1 2 3\n", {}, "a.xyz"), "it has 1"));
  EXPECT_TRUE(has(bad("2\nc\nAr 1 2 3\nAr 1 x 3\n", {}, "a.xyz"), "a.xyz:4: column 3 (y): 'x' is not a number"));
}

TEST_F(Text, AFileThatIsChangedWhileItIsReadIsToldFromOneThatIsNot) {
  const std::string path = directory_.write("p.csv", "1,2,3\n4,5,6\n");
  for (const char* change : {"longer", "cut", "written", "replaced"}) {
    const auto file = InputFile::open(path);
    ASSERT_TRUE(file.ok());
    EXPECT_TRUE(file->check_unchanged().ok());
    const std::string how = change;
    std::this_thread::sleep_for(std::chrono::milliseconds(20));  // a file's time may have ticks of 10 ms
    if (how == "longer") std::ofstream(path, std::ios::app) << "7,8,9\n";
    if (how == "cut") std::filesystem::resize_file(path, 6);
    if (how == "written") std::fstream(path, std::ios::in | std::ios::out) << "9";
    if (how == "replaced") directory_.write("p.csv", "1,2,3\n4,5,6\n");
    // The descriptor of a file that was replaced still reads what was opened.
    EXPECT_EQ(file->check_unchanged().ok(), how == "replaced") << how;
    const auto again = InputFile::open(path);
    ASSERT_TRUE(again.ok());
    EXPECT_FALSE(again->version() == file->version()) << how;
  }
}

TEST_F(Text, FilesThatAreNoFiles) {
  EXPECT_EQ(read_points(directory_ / "none.csv", {}).status().code(), Code::not_found);
  const auto directory = read_points(directory_ / "", {});
  EXPECT_TRUE(has(refusal(directory), "is a directory"));
  const std::string fifo = directory_ / "fifo.csv";
  ASSERT_EQ(::mkfifo(fifo.c_str(), 0600), 0);
  EXPECT_TRUE(has(refusal(read_points(fifo, {})), "is not a regular file"));
}

}  // namespace
}  // namespace rcb::io
