#include "client/cli/files/fetched.hpp"

#include "common/base/axis_names.hpp"

namespace rcb::cli {

Result<Fetched> fetched(const client::Reply& reply) {
  const client::Array* id = reply.find("id");
  const client::Array* part = reply.find("part");
  const client::Array* weight = reply.find("w");
  if (id == nullptr || part == nullptr || id->dtype != "<i8" || part->dtype != "<i4")
    return Status(Code::protocol_error, "the answer to fetch lacks its ids or parts");
  Fetched set{{}, id->i8(), std::nullopt, part->i4()};
  for (const char* name : kAxisNames)
    if (const client::Array* axis = reply.find(name); axis != nullptr && axis->dtype == "<f8")
      set.axes.push_back(axis->f8());
  if (weight != nullptr && weight->dtype == "<f8") set.weight = weight->f8();
  bool equal = !set.axes.empty() && set.part.size() == set.id.size();
  for (const auto& axis : set.axes) equal = equal && axis.size() == set.id.size();
  if (!equal || (set.weight && set.weight->size() != set.id.size()))
    return Status(Code::protocol_error, "the arrays of fetch differ in length");
  return set;
}

}  // namespace rcb::cli
