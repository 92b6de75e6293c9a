#include "server/scene/journal.hpp"

#include <algorithm>
#include <optional>
#include <utility>

#include <fmt/format.h>

#include "common/base/random.hpp"
#include "common/files/paths.hpp"
#include "common/wire/message.hpp"

namespace rcb::scene {
namespace {

constexpr const char* kScenes = "scenes";
constexpr const char* kState = "state";
constexpr std::size_t kHexDigits = 16;

std::string folder_name(const SceneFolder& scene) {
  return fmt::format("{}.{}", scene.name, wire::hex64(scene.incarnation));
}

std::optional<SceneFolder> parse_folder_name(const std::string& name) {
  if (name.size() <= kHexDigits + 1) return {};
  const std::size_t dot = name.size() - kHexDigits - 1;
  const auto incarnation = wire::parse_hex64(name.substr(dot + 1));
  if (!incarnation.ok()) return {};
  SceneFolder scene{name.substr(0, dot), *incarnation};
  const bool same = wire::check_scene_name(scene.name).ok() && folder_name(scene) == name;
  return same ? std::optional(std::move(scene)) : std::nullopt;
}

}  // namespace

std::string SceneFolder::path(const std::string& data) const {
  return join_path(join_path(data, kScenes), folder_name(*this));
}

Result<std::vector<SceneFolder>> scene_folders(const Storage& storage, const std::string& data) {
  const auto names = storage.names_in(join_path(data, kScenes));
  if (!names.ok()) return names.status();
  std::vector<SceneFolder> found;
  for (const std::string& name : *names)
    if (auto scene = parse_folder_name(name)) found.push_back(std::move(*scene));
  return found;
}

Result<std::string> set_scenes_aside(Storage& storage, const std::string& data) {
  const auto names = storage.names_in(data);
  if (!names.ok()) return names.status();
  if (std::find(names->begin(), names->end(), kScenes) == names->end()) return std::string();
  std::string aside;
  for (int n = 1; aside.empty() || std::find(names->begin(), names->end(), aside) != names->end(); ++n)
    aside = fmt::format("{}.old-{}", kScenes, n);
  aside = join_path(data, aside);
  if (Status renamed = storage.rename(join_path(data, kScenes), aside); !renamed) return renamed;
  return aside;
}

Status remove_scene_folder(Storage& storage, const std::string& path) {
  const auto names = storage.names_in(path);
  if (!names.ok()) return names.status();
  if (Status removed = storage.remove(join_path(path, kState)); !removed) return removed;
  for (const std::string& name : *names)
    if (Status removed = storage.remove(join_path(path, name)); !removed) return removed;
  return storage.remove(path);
}

Journal::Journal(Storage& storage, std::string path, std::uint64_t seed)
    : storage_(&storage),
      path_(std::move(path)),
      state_(storage, join_path(path_, kState), mix64(seed)),
      cuts_(storage, join_path(path_, "cuts"), mix64(seed + 1)),
      reports_(storage, path_, mix64(seed + 2)) {}  // so none is taken for another

Result<Journal> Journal::create(Storage& storage, const std::string& data, const SceneFolder& scene) {
  const std::string path = scene.path(data);
  if (Status made = storage.make_folder(path); !made) return made;
  const auto names = storage.names_in(path);
  if (!names.ok()) return names.status();
  if (!names->empty()) return Status(Code::already_exists, path + " is there already");
  return Journal(storage, path, scene.incarnation);
}

Result<Journal> Journal::open(Storage& storage, const std::string& data, const SceneFolder& scene,
                              JournalFound& found) {
  const std::string path = scene.path(data);
  if (Status checked = storage.make_folder(path); !checked) return checked;
  Journal journal(storage, path, scene.incarnation);
  found = {};
  for (Status status : {journal.state_.open(found.states, found.faults), journal.cuts_.open(found.cuts, found.faults),
                        journal.reports_.open(found.faults)})
    if (!status.ok()) return status;
  return journal;
}

Status Journal::remove() {
  const std::string path = path_;
  Storage& storage = *storage_;
  *this = Journal(storage, path, 0);  // unmaps the files
  return remove_scene_folder(storage, path);
}

}  // namespace rcb::scene
