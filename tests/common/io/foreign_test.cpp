// Formats that aren't read are named as what they are, with what to do; what is read is never taken for one.
#include "common/io/formats/foreign.hpp"

#include <gtest/gtest.h>

#include "common/io/points.hpp"
#include "tests/common/io/files.hpp"

namespace rcb::io {
namespace {

using std::string_view_literals::operator""sv;

struct Known {
  const char* file;
  std::string_view content;
  const char* named;
  const char* remedy;
};

const std::vector<Known> kKnown{
    {"a.npz", "PK\x03\x04\x14\0\0\0\0\0\0\0!\0\xF6\xE9\x97\xDE\x80]\0\0\x80]\0\0\x05\0\x14\0x.npy"sv, ".npz",
     "numpy.save"},
    {"a.xlsx", "PK\x03\x04\x14\0\x06\0\x08\0\0\0!\0b\xEE\x9Dh^\x01\0\0\x90\x04\0\0\x13\0\x08\x02[Content_Types].xml"sv,
     "spreadsheet", "CSV"},
    {"a.zip", "PK\x03\x04\x14\0\0\0\x08\0\0\0!\0b\xEE\x9Dh^\x01\0\0\x90\x04\0\0\x0A\0\0\0points.csv"sv, "ZIP",
     "unpack"},
    {"a.csv.zst", "\x28\xB5\x2F\xFD\0"sv, "zstd", "unpack"},
    {"a.parquet", "PAR1\x15\x04"sv, "Parquet", "read_parquet"},
    {"a.xls", "\xD0\xCF\x11\xE0\xA1\xB1\x1A\xE1"sv, "Excel", "CSV"},
    {"a.vtk", "# vtk DataFile Version 3.0\nx\nASCII\nDATASET POLYDATA\nPOINTS 1 double\n0 0 0\n"sv, "legacy VTK",
     "ParaView"},
    {"a.vtu", "<?xml version=\"1.0\"?>\n<VTKFile type=\"UnstructuredGrid\">\n"sv, "VTK XML", "ParaView"},
    {"a.vtp", "<VTKFile type=\"PolyData\">\n"sv, "VTK XML", "ParaView"},
    {"a.data", "LAMMPS data file via write_data\n\n1 atoms\n1 atom types\n\n0 1 xlo xhi\n\nAtoms\n\n1 1 0 0 0\n"sv,
     "LAMMPS data", "Atoms"},
    {"a.ply", "ply\nformat ascii 1.0\n"sv, "PLY", "CSV"},
    {"a.nc", "CDF\x01\0\0\0\0"sv, "NetCDF", "HDF5"},
    {"a.dcd", "\x54\0\0\0CORD"sv, "DCD", ".npy"},
    {"a.pkl", "\x80\x04\x95"sv, "pickle", "numpy.save"},
    {"a.json", "[[0,0,0]]\n"sv, "JSON", "CSV"},
    {"a.txt", "\xFF\xFEx\0,\0"sv, "UTF-16", "UTF-8"},
    {"a.csv", "x,y,z\r1,2,3\r4,5,6\r"sv, "carriage return", "line ends"},
    {"a.bin", "\x01\0\0\0\0\0\0\0\0"sv, "no text", "CSV"},
};

TEST(Foreign, IsNamed) {
  const testing::Directory directory;
  for (const Known& known : kKnown) {
    const std::string path = directory.write(known.file, known.content);
    for (const Status& status : {testing::read_points(path, {}).status(), read_points_slice(path, {}, 1, 3).status(),
                                 open_trajectory(path, {}).status()}) {
      EXPECT_EQ(status.code(), Code::invalid_argument) << known.file;
      EXPECT_NE(status.message().find(path + ": is "), std::string::npos) << status.message();
      EXPECT_NE(status.message().find(known.named), std::string::npos) << status.message();
      EXPECT_NE(status.hint().find(known.remedy), std::string::npos) << status.hint();
      EXPECT_EQ(status.hint().find("{}"), std::string::npos) << status.hint();
    }
  }
}

TEST(Foreign, WhatIsReadIsNotTakenForIt) {
  const testing::Directory directory;
  for (const std::string_view content :
       {"x,y,z\n1,2,3\n"sv, "# a comment\n1 2 3\n"sv, "1\n2\n"sv, "\xEF\xBB\xBFx,y\n1,2\n"sv, ""sv,
        "atom x y z\n1 0 0 0\n"sv, "B x y\n1 2 3\n"sv}) {
    const auto file = InputFile::open(directory.write("points.csv", content));
    ASSERT_TRUE(file.ok());
    EXPECT_TRUE(check_not_foreign(*file).ok()) << content;
  }
}

}  // namespace
}  // namespace rcb::io
