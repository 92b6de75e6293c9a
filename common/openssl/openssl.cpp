#include "common/openssl/openssl.hpp"

#include <string>

#include <dlfcn.h>
#include <fmt/format.h>

namespace rcb {
namespace {

// A function that is missing leaves its pointer null.
template <typename Function>
bool find_function(void* library, const char* name, Function& pointer) {
  pointer = reinterpret_cast<Function>(::dlsym(library, name));
  return pointer != nullptr;
}

Status find_openssl() {
  // The version whose headers this was compiled with: others differ in types and macros. Those of libcrypto are found
  // through it.
  const std::string name = fmt::format("libssl.so.{}", OPENSSL_SHLIB_VERSION);
  void* library = ::dlopen(name.c_str(), RTLD_NOW | RTLD_LOCAL);
  bool found = library != nullptr;
#define RCB_OPENSSL_FIND(name) found = found && find_function(library, #name, name);
  RCB_OPENSSL_FUNCTIONS(RCB_OPENSSL_FIND)
#undef RCB_OPENSSL_FIND
  if (found) return {};
  const char* why = ::dlerror();
  return {Code::unsupported, fmt::format("OpenSSL can't be opened here: {}", why != nullptr ? why : name),
          fmt::format("TCP needs it: install OpenSSL {} (Debian's package libssl3; {} must be where the dynamic linker "
                      "looks), or use a service on this machine through its Unix socket",
                      OPENSSL_VERSION_MAJOR, name)};
}

}  // namespace

Status open_openssl() {
  static const Status opened = find_openssl();
  return opened;
}

}  // namespace rcb
