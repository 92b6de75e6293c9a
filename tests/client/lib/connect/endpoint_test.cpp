#include "client/lib/connect/endpoint.hpp"

#include <cstdlib>
#include <filesystem>
#include <set>

#include <gtest/gtest.h>
#include <unistd.h>

namespace rcb::client {
namespace {

std::string canonical(const std::string& text) {
  const auto endpoint = parse_endpoint(text);
  return endpoint.ok() ? endpoint->text() : endpoint.status().message();
}

TEST(Endpoint, CanonicalText) {
  EXPECT_EQ(canonical("unix:/tmp/a.sock"), "unix:/tmp/a.sock");
  EXPECT_EQ(canonical("unix:/tmp//x/../a.sock"), "unix:/tmp/a.sock");
  EXPECT_EQ(canonical("/tmp/a.sock"), "unix:/tmp/a.sock");
  EXPECT_EQ(canonical("unix:a.sock"), "unix:" + (std::filesystem::current_path() / "a.sock").string());
  EXPECT_EQ(canonical("127.0.0.1:7470"), "127.0.0.1:7470");
  EXPECT_EQ(canonical("Node7.Example:1"), "node7.example:1");
  EXPECT_EQ(canonical("[::1]:65535"), "[::1]:65535");
  const std::string longest = "unix:/" + std::string(106, 'x');  // the kernel takes 107 bytes
  EXPECT_EQ(canonical(longest), longest);
}

TEST(Endpoint, WhatIsNoneIsRefused) {
  for (const std::string& text :
       {std::string(), std::string("host"), std::string(":7470"), std::string("host:"), std::string("host:0"),
        std::string("host:65536"), std::string("host:7a"), std::string("host:-1"), std::string("::1:7470"),
        std::string("[]:7470"), std::string("[::1]7470"), std::string("a b:1"), std::string("unix:"),
        "unix:/" + std::string(107, 'x'), std::string("unix:/a\0b", 9)}) {
    const auto endpoint = parse_endpoint(text);
    ASSERT_FALSE(endpoint.ok()) << text;
    EXPECT_EQ(endpoint.status().code(), Code::invalid_argument);
    EXPECT_FALSE(endpoint.status().hint().empty());
  }
}

TEST(Endpoint, FilesLieTogetherAndApartFromOthers) {
  std::set<std::string> directories;
  const char* texts[] = {"unix:/a/b", "unix:/a+b", "unix:/a%2Fb", "unix:/a.b", "a.b:1", "a.b:11", "[::1]:1", "[::]:11"};
  for (const char* text : texts) directories.insert(data_directory(parse_endpoint(text).value()));
  EXPECT_EQ(directories.size(), std::size(texts));
  const Endpoint endpoint = parse_endpoint("unix:/a/b").value();
  EXPECT_EQ(data_directory(endpoint), data_directory(parse_endpoint("unix:/a/./c/../b").value()));
  EXPECT_EQ(token_path(endpoint), data_directory(endpoint) + "/token");
}

TEST(Endpoint, ATokenThatIsNotSharedIsTold) {
  ::unsetenv("RCBD_TOKEN");
  ::unsetenv("RCBD_TOKEN_FILE");
  Endpoint endpoint = parse_endpoint("node7.example:7470").value();
  endpoint.published = "the service that wrote /home/u/where (job 3 on host node7)";
  endpoint.token_file = "/nowhere/token";
  const auto tokens = tokens_for(endpoint, "", false);
  ASSERT_EQ(tokens.status().code(), Code::not_authorised);
  EXPECT_EQ(
      tokens.status().message(),
      "the service that wrote /home/u/where (job 3 on host node7) says that its token is in /nowhere/token, which "
      "can't be read on this machine");
  EXPECT_EQ(tokens_for(endpoint, "t", false).value(), (std::vector<std::string>{"t"}));
}

TEST(Endpoint, NoTokenFromAFileForAnotherMachine) {
  ::unsetenv("RCBD_TOKEN");
  ::unsetenv("RCBD_TOKEN_FILE");
  const Endpoint endpoint = parse_endpoint("node7.example:7470").value();
  EXPECT_TRUE(tokens_for(endpoint, "", false).value().empty());
  EXPECT_EQ(tokens_for(endpoint, "t", false).value(), (std::vector<std::string>{"t"}));
}

}  // namespace
}  // namespace rcb::client
