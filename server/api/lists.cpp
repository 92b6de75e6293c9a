#include "server/api/lists.hpp"

namespace rcb::api {

bool given(const wire::Json& request, const char* name) {
  const auto found = request.find(name);
  return found != request.end() && !found->is_null();
}

Result<Page> read_page(const wire::Json& request, std::uint64_t total, std::uint64_t otherwise, std::uint64_t most) {
  const auto from = wire::integer_field_or(request, "from", 0, wire::kIntegerMax, static_cast<std::int64_t>(otherwise));
  if (!from.ok()) return from.status();
  const auto count = wire::integer_field_or(request, "count", 1, wire::kIntegerMax, wire::kIntegerMax);
  if (!count.ok()) return count.status();
  Page page;
  page.from = std::min(static_cast<std::uint64_t>(*from), total);
  page.end = page.from + std::min({static_cast<std::uint64_t>(*count), most, total - page.from});
  return page;
}

}  // namespace rcb::api
