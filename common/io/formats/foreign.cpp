#include "common/io/formats/foreign.hpp"

#include <algorithm>
#include <array>
#include <optional>

#include <fmt/format.h>

#include "common/io/formats/fields.hpp"

namespace rcb::io {
namespace {

using std::string_view_literals::operator""sv;

constexpr std::size_t kHeadBytes = 4096;

struct Format {
  std::string_view name;    // completes "the file is ..."
  std::string_view remedy;  // what to do; {} is the file
};

constexpr std::string_view kUnpack = "unpack it first";
constexpr std::string_view kAsCsv = "save the positions as CSV, with columns x, y, z";
constexpr std::string_view kVtkAsCsv = "in ParaView: File, Save Data, CSV; or save the points with numpy.save as .npy";

struct Magic {
  std::size_t at;  // its offset in the file
  std::string_view bytes;
  Format format;
};

constexpr std::array kMagics{
    Magic{0, "BZh"sv, {"compressed by bzip2", kUnpack}},
    Magic{0,
          "\xFD"
          "7zXZ"sv,
          {"compressed by xz", kUnpack}},
    Magic{0, "\x28\xB5\x2F\xFD"sv, {"compressed by zstd", kUnpack}},
    Magic{0, "\x04\x22\x4D\x18"sv, {"compressed by lz4", kUnpack}},
    Magic{0,
          "PAR1"sv,
          {"a Parquet file", "save it with pandas: read_parquet('{}')[['x', 'y', 'z']].to_csv('points.csv')"}},
    Magic{0, "ARROW1"sv, {"an Arrow file", kAsCsv}},
    Magic{0, "FEA1"sv, {"a Feather file", kAsCsv}},
    Magic{0, "\xD0\xCF\x11\xE0"sv, {"an Excel workbook", "save the sheet as CSV"}},
    Magic{0, "# vtk DataFile"sv, {"a legacy VTK file", kVtkAsCsv}},
    Magic{0, "<VTKFile"sv, {"a VTK XML file", kVtkAsCsv}},
    Magic{0, "ply\n"sv, {"a PLY file", kAsCsv}},
    Magic{0, "ply\r"sv, {"a PLY file", kAsCsv}},
    Magic{0, "# .PCD"sv, {"a PCD point cloud", kAsCsv}},
    Magic{0, "LASF"sv, {"a LAS point cloud", kAsCsv}},
    Magic{0, "CDF\x01"sv, {"a NetCDF file", "convert it to NetCDF-4, which is HDF5: nccopy -k nc4 {} points.h5"}},
    Magic{0, "CDF\x02"sv, {"a NetCDF file", "convert it to NetCDF-4, which is HDF5: nccopy -k nc4 {} points.h5"}},
    Magic{0, "CDF\x05"sv, {"a NetCDF file", "convert it to NetCDF-4, which is HDF5: nccopy -k nc4 {} points.h5"}},
    Magic{0, "MATLAB "sv, {"a MATLAB file", "save the matrix as CSV: writematrix(xyz, 'points.csv')"}},
    Magic{0, "SQLite format 3"sv, {"an SQLite database", kAsCsv}},
    Magic{4, "CORD"sv, {"a DCD trajectory", "write its frames as .npy of shape (steps, n, dims)"}},
    Magic{0, "\0\0\x07\xCB"sv, {"an XTC trajectory", "write its frames as .npy of shape (steps, n, dims)"}},
    Magic{0, "\0\0\x07\xC9"sv, {"a TRR trajectory", "write its frames as .npy of shape (steps, n, dims)"}},
    Magic{0, "\x80\x02"sv, {"a Python pickle", "save the array with numpy.save as .npy"}},
    Magic{0, "\x80\x03"sv, {"a Python pickle", "save the array with numpy.save as .npy"}},
    Magic{0, "\x80\x04"sv, {"a Python pickle", "save the array with numpy.save as .npy"}},
    Magic{0, "\x80\x05"sv, {"a Python pickle", "save the array with numpy.save as .npy"}},
    Magic{0, "\xFF\xFE"sv, {"text in UTF-16", "save it as UTF-8"}},
    Magic{0, "\xFE\xFF"sv, {"text in UTF-16", "save it as UTF-8"}},
    Magic{0, "{"sv, {"JSON", kAsCsv}},
    Magic{0, "["sv, {"JSON", kAsCsv}},
    Magic{0, "HETATM"sv, {"a PDB file", "write it as XYZ"}},
    Magic{0, "CRYST1"sv, {"a PDB file", "write it as XYZ"}},
    Magic{0, "ATOM  "sv, {"a PDB file", "write it as XYZ"}},
};

// NumPy's .npz and Office's files are ZIP archives; the first file's name, at byte 30, tells which.
Format zip_format(std::string_view head) {
  const std::string_view name = head.substr(std::min<std::size_t>(30, head.size()), 128);
  if (name.find(".npy") != std::string_view::npos)
    return {"an .npz archive of arrays", "save one of its arrays: numpy.save('points.npy', numpy.load('{}')['NAME'])"};
  if (name.starts_with("[Content_Types].xml") || name.starts_with("_rels/") || name.starts_with("xl/") ||
      name.starts_with("mimetype"))
    return {"a spreadsheet or another Office file", "save the sheet as CSV"};
  return {"a ZIP archive", kUnpack};
}

// True if one of the first lines is like "1000 atoms".
bool is_lammps_data(std::string_view head) {
  constexpr int kLinesMax = 20;
  for (int line = 0; line < kLinesMax && !head.empty(); ++line) {
    const std::size_t end = std::min(head.find('\n'), head.size());
    const auto fields = split_fields(trimmed(head.substr(0, end)), kBlankSeparator);
    if (fields.size() == 2 && fields[1] == "atoms" && id_in(fields[0])) return true;
    head.remove_prefix(std::min(end + 1, head.size()));
  }
  return false;
}

std::optional<Format> format_of(std::string_view head) {
  if (head.empty()) return std::nullopt;
  if (head.starts_with("PK\x03\x04")) return zip_format(head);
  for (const Magic& magic : kMagics)
    if (head.size() > magic.at && head.substr(magic.at).starts_with(magic.bytes)) return magic.format;
  if (head.starts_with("<?xml")) {
    if (head.find("<VTKFile") != std::string_view::npos) return Format{"a VTK XML file", kVtkAsCsv};
    return Format{"XML", kAsCsv};
  }
  if (head.starts_with("solid ") && head.find("facet") != std::string_view::npos)
    return Format{"an STL surface", kAsCsv};
  if (is_lammps_data(head))
    return Format{"a LAMMPS data file",
                  "save the rows of its section Atoms as CSV, with a first line that names the columns: id,type,x,y,z"};
  if (head.find('\n') == std::string_view::npos && head.substr(0, head.size() - 1).find('\r') != std::string_view::npos)
    return Format{"text whose lines end in a carriage return alone", "save it with the line ends of Unix or Windows"};
  if (head.substr(0, head.find('\n')).find('\0') != std::string_view::npos)
    return Format{"no text", "what is read: CSV and other text, XYZ, LAMMPS dumps, .npy, HDF5"};
  return std::nullopt;
}

}  // namespace

Status check_not_foreign(const InputFile& file) {
  std::string head(static_cast<std::size_t>(std::min<std::uint64_t>(file.size(), kHeadBytes)), '\0');
  if (Status read = file.read_at(0, head.data(), head.size()); !read.ok()) return read;
  const auto format = format_of(head);
  if (!format) return {};
  std::string remedy(format->remedy);
  if (const std::size_t at = remedy.find("{}"); at != std::string::npos) remedy.replace(at, 2, file.path());
  return {Code::invalid_argument, fmt::format("{}: is {}, which isn't read", file.path(), format->name), remedy};
}

}  // namespace rcb::io
