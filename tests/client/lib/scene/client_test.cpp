#include "client/lib/client.hpp"

#include <algorithm>
#include <csignal>
#include <limits>
#include <optional>
#include <random>
#include <set>

#include <fcntl.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <sys/wait.h>
#include <unistd.h>

#include "client/lib/connect/endpoint.hpp"
#include "common/base/random.hpp"
#include "tests/client/lib/fake_service.hpp"
#include "tests/support/variable.hpp"

namespace rcb::client {
namespace {

using testing::Variable;

// Greets and answers every request with what `answer` says.
FakeService::Script answering(const std::function<void(Peer&, const Received&)>& answer) {
  return [answer](Peer& peer, int) {
    if (!peer.greet(4)) return;
    while (auto frame = peer.receive()) {
      if (frame->type == protocol::FrameType::goodbye) return;
      answer(peer, *frame);
    }
  };
}

// The page's own example, so that the fake service can be believed.
TEST(Protocol, AFrameByteByByte) {
  const std::string header("RCBD\2\0\3\0\0\0\0\0\x14\0\0\0\1\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0", 32);
  EXPECT_EQ(protocol::frame(protocol::FrameType::request, 1, {{"command", "status"}}),
            header + "\xae\xc0\x32\xe0\x05\x78\xf7\x45" + R"({"command":"status"})");
}

TEST(Connect, SaysHelloAndGoodbye) {
  for (const bool tcp : {false, true}) {
    protocol::Json hello;
    bool goodbye = false;
    FakeService service(
        [&](Peer& peer, int) {
          const auto said = peer.greet(4, "0000000000000001", tcp ? "secret" : "");
          ASSERT_TRUE(said.has_value());
          EXPECT_EQ(said->type, protocol::FrameType::hello);
          hello = said->json;
          const auto last = peer.receive();
          goodbye = last && last->type == protocol::FrameType::goodbye;
        },
        tcp);
    {
      auto client = Client::connect({.endpoint = service.endpoint(), .name = "test 1", .token = "secret"});
      ASSERT_TRUE(client.ok()) << client.status().message();
      EXPECT_EQ(client->ranks(), 4);
      EXPECT_EQ(client->endpoint(), service.endpoint());
    }
    service.stop();
    EXPECT_EQ(hello["protocol"], 2);
    EXPECT_EQ(hello["client"], "test 1");
    EXPECT_TRUE(protocol::is_hex64(hello["session"]));
    EXPECT_FALSE(hello.contains("token"));
    EXPECT_TRUE(goodbye);
  }
}

TEST(Connect, NobodyThere) {
  const Directory directory;
  const std::string endpoint = "unix:" + directory.path() + "/none";
  const auto client = Client::connect({.endpoint = endpoint});
  ASSERT_FALSE(client.ok());
  EXPECT_EQ(client.status().code(), Code::unavailable);
  EXPECT_EQ(client.status().message(), "no service answers at " + endpoint);
  EXPECT_EQ(client.status().hint(), "start one: rcbctl up");
  EXPECT_EQ(Client::connect({.endpoint = "nonsense"}).status().code(), Code::invalid_argument);
  EXPECT_EQ(Client::connect({.endpoint = endpoint, .deadline_seconds = 0}).status().code(), Code::invalid_argument);
  const Variable path("RCBD_PATH", "straight");
  EXPECT_EQ(Client::connect({.endpoint = endpoint}).status().message(), "RCBD_PATH is 'straight'");
  const double nan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(Client::connect({.endpoint = endpoint, .deadline_seconds = nan}).status().code(), Code::invalid_argument);
}

// As a service does with the oldest of too many that haven't said hello, or one that is just ending.
TEST(Connect, WhoIsSentAwayComesAgain) {
  int patience = 3;
  FakeService service([&](Peer& peer, int number) {
    const Status status{Code::unavailable, "too many connections", "try again"};
    if (number >= patience) {
      if (peer.greet(1)) peer.receive();
    } else if (peer.send(protocol::FrameType::welcome, 0, Peer::welcome()) && number > 0) {
      peer.send(protocol::FrameType::failure, 0, protocol::failure_json(status));
    }
  });
  EXPECT_TRUE(Client::connect({.endpoint = service.endpoint()}).ok());
  patience = std::numeric_limits<int>::max();
  const Status status = Client::connect({.endpoint = service.endpoint(), .deadline_seconds = 0.3}).status();
  EXPECT_EQ(status.code(), Code::unavailable);
  EXPECT_EQ(status.message(), "too many connections");
}

TEST(Connect, WithoutADescriptorLeftSaysSo) {
#ifdef __SANITIZE_ADDRESS__
  GTEST_SKIP() << "the sanitizer needs a descriptor to look at an object, and takes it for none";
#endif
  rlimit before{};
  ASSERT_EQ(::getrlimit(RLIMIT_NOFILE, &before), 0);
  const int next = ::dup(0);
  ASSERT_GE(next, 0);
  ::close(next);
  int short_of = 0;
  for (rlim_t more = 0; more < 20; ++more) {
    const rlimit few{static_cast<rlim_t>(next) + more, before.rlim_max};
    ::setrlimit(RLIMIT_NOFILE, &few);
    const Status status = Client::connect({.endpoint = "unix:/nonexistent/socket"}).status();
    ::setrlimit(RLIMIT_NOFILE, &before);
    EXPECT_EQ(status.code(), Code::unavailable);
    if (status.message().find("no service answers") != std::string::npos) break;
    ++short_of;
    EXPECT_NE(status.message().find("no file descriptors left"), std::string::npos) << status.message();
    EXPECT_NE(status.hint().find("ulimit -n"), std::string::npos) << status.hint();
  }
  EXPECT_GT(short_of, 0);
  EXPECT_LT(short_of, 20);
}

// A process that a solver forks off has its client, too, and ends with all destructors.
TEST(Connect, AForkedCopySaysNothing) {
  std::vector<protocol::Json> asked;
  FakeService service([&](Peer& peer, int) {
    peer.greet(1);
    const auto open = peer.receive();
    peer.reply(*open, {{"scene", "s"}, {"dims", 2}, {"parts", 2}, {"n", 0}, {"epoch", 0}, {"step", nullptr}});
    while (const auto request = peer.receive()) {
      if (request->type == protocol::FrameType::goodbye) break;
      asked.push_back(request->json);
      peer.reply(*request, protocol::Json::object());
    }
  });
  {
    auto client = Client::connect({.endpoint = service.endpoint()});
    ASSERT_TRUE(client.ok());
    std::optional<Scene> scene;
    if (auto opened = client->open_scene("s"); opened.ok()) scene.emplace(std::move(*opened));
    ASSERT_TRUE(scene.has_value());
    const pid_t child = ::fork();
    if (child == 0) {
      scene.reset();
      { const Client gone = std::move(*client); }
      ::_exit(0);
    }
    int ended = -1;
    ASSERT_EQ(::waitpid(child, &ended, 0), child);
    EXPECT_EQ(ended, 0);
    EXPECT_TRUE(client->call("status", "{}").ok());
  }
  service.stop();
  ASSERT_EQ(asked.size(), 2U);
  EXPECT_EQ(asked[0]["command"], "status");
  EXPECT_EQ(asked[1]["command"], "scene.close");
}

// Or they would keep a dead solver's connection open.
TEST(Connect, ProgramsThatTheSolverStartsInheritNoSocket) {
  FakeService service([](Peer& peer, int) {
    peer.greet(1);
    peer.receive();
  });
  const auto sockets = [] {
    std::set<int> found;
    for (int descriptor = 0; descriptor < 1024; ++descriptor) {
      struct stat info {};
      if (::fstat(descriptor, &info) == 0 && S_ISSOCK(info.st_mode)) found.insert(descriptor);
    }
    return found;
  };
  const std::set<int> before = sockets();
  const auto client = Client::connect({.endpoint = service.endpoint()});
  ASSERT_TRUE(client.ok());
  int inherited = 0;
  int of_client = 0;
  for (const int descriptor : sockets()) {
    sockaddr_un peer{};
    socklen_t size = sizeof peer;
    if (before.contains(descriptor) || ::getpeername(descriptor, reinterpret_cast<sockaddr*>(&peer), &size) != 0 ||
        size <= sizeof peer.sun_family)
      continue;  // the service's own end has no name at the other side
    ++of_client;
    inherited += (::fcntl(descriptor, F_GETFD) & FD_CLOEXEC) == 0 ? 1 : 0;
  }
  EXPECT_EQ(of_client, 1);
  EXPECT_EQ(inherited, 0);
}

TEST(Connect, WhereManyWaitAtASocketItWaitsToo) {
  const Directory directory;
  const std::string path = directory.path() + "/s";
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  std::copy(path.begin(), path.end(), address.sun_path);
  const auto* const at = reinterpret_cast<const sockaddr*>(&address);
  const int listener = ::socket(AF_UNIX, SOCK_STREAM, 0);
  ASSERT_EQ(::bind(listener, at, sizeof address), 0);
  ASSERT_EQ(::listen(listener, 0), 0);
  std::vector<int> waiting;
  int connected = 0;
  while (connected == 0) {
    waiting.push_back(::socket(AF_UNIX, SOCK_STREAM | SOCK_NONBLOCK, 0));
    connected = ::connect(waiting.back(), at, sizeof address);
  }
  EXPECT_EQ(errno, EAGAIN);
  const Status status = Client::connect({.endpoint = "unix:" + path, .deadline_seconds = 0.05}).status();
  EXPECT_EQ(status.code(), Code::deadline_exceeded) << status.message();
  for (const int socket : waiting) ::close(socket);
  ::close(listener);
}

TEST(Connect, ToldNothingNamesAllThatWasTried) {
  const Directory directory;
  const Variable runtime("XDG_RUNTIME_DIR", directory.path().c_str());
  const Variable none("RCBD_ENDPOINT", nullptr);
  const auto client = Client::connect({});
  if (client.ok() || client.status().code() != Code::unavailable) GTEST_SKIP() << "something listens on port 7470";
  EXPECT_EQ(client.status().message(),
            "no service answers at unix:" + directory.path() + "/rcbd/rcbd.sock nor 127.0.0.1:7470");
}

TEST(Connect, EndpointFromTheEnvironment) {
  FakeService service([](Peer& peer, int) {
    peer.greet(1);
    peer.receive();
  });
  const Variable endpoint("RCBD_ENDPOINT", service.endpoint().c_str());
  EXPECT_TRUE(Client::connect({}).ok());
}

TEST(Connect, RefusalsAreTold) {
  FakeService service([](Peer& peer, int number) {
    if (number == 0) {  // instead of a welcome
      peer.send(protocol::FrameType::failure, 0, protocol::failure_json({Code::busy, "256 sessions", "come later"}));
      return;
    }
    if (number == 1) {
      peer.send(protocol::FrameType::welcome, 0, Peer::welcome());
      if (const auto hello = peer.receive()) peer.fail(*hello, {Code::not_authorised, "another user", "ask them"});
      return;
    }
    protocol::Json welcome = Peer::welcome();
    welcome["protocol"] = 1;
    peer.send(protocol::FrameType::welcome, 0, welcome);
    peer.receive();
  });
  const ConnectOptions options{.endpoint = service.endpoint()};
  Status status = Client::connect(options).status();
  EXPECT_EQ(status.code(), Code::busy);
  EXPECT_EQ(status.hint(), "come later");
  status = Client::connect(options).status();
  EXPECT_EQ(status.code(), Code::not_authorised);
  EXPECT_EQ(status.message(), "another user");
  EXPECT_EQ(Client::connect(options).status().code(), Code::protocol_error);
}

TEST(Connect, SilentPeerMeetsTheDeadline) {
  for (const bool tcp : {false, true}) {
    FakeService service([](Peer& peer, int) { peer.receive(); }, tcp);
    const Status status = Client::connect({.endpoint = service.endpoint(), .deadline_seconds = 0.1}).status();
    EXPECT_EQ(status.code(), Code::deadline_exceeded) << status.message();
    EXPECT_NE(status.message().find(service.endpoint()), std::string::npos) << status.message();
  }
}

TEST(Connect, TokenComesFromOptionsEnvironmentOrTheDataDirectory) {
  const Directory state;
  const Variable home("XDG_STATE_HOME", state.path().c_str());
  const Variable no_token("RCBD_TOKEN", nullptr);
  const Variable no_file("RCBD_TOKEN_FILE", nullptr);
  const std::vector<std::string> known{"given", "of the environment", "of the file",
                                       "wrong", "of the directory",   "of the next start"};
  std::vector<std::string> tokens;
  FakeService service(
      [&](Peer& peer, int) {
        const std::string nonce = auth::random_nonce();
        peer.send(protocol::FrameType::welcome, 0, Peer::welcome(nonce));
        const auto hello = peer.receive();
        if (!hello) return;
        for (const std::string& token : known)
          if (hello->json["proof"] == Peer::proof(auth::Role::client, token, nonce, *hello)) tokens.push_back(token);
        ASSERT_FALSE(tokens.empty());
        if (tokens.back() == "wrong")
          peer.fail(*hello, {Code::not_authorised, "wrong token"});
        else
          peer.reply(*hello, {{"ranks", 1}, {"proof", Peer::proof(auth::Role::service, tokens.back(), nonce, *hello)}});
        peer.receive();
      },
      true);
  EXPECT_EQ(Client::connect({.endpoint = service.endpoint()}).status().code(), Code::not_authorised);
  EXPECT_TRUE(Client::connect({.endpoint = service.endpoint(), .token = "given"}).ok());
  {
    const Variable token("RCBD_TOKEN", "of the environment");
    EXPECT_TRUE(Client::connect({.endpoint = service.endpoint()}).ok());
  }
  const auto write = [](const std::string& path, const std::string& text) {
    std::filesystem::create_directories(std::filesystem::path(path).parent_path());
    std::unique_ptr<FILE, int (*)(FILE*)> file(std::fopen(path.c_str(), "w"), std::fclose);
    std::fputs(text.c_str(), file.get());
  };
  const std::string file = state.path() + "/file";
  write(file, "of the file\n");
  {
    const Variable path("RCBD_TOKEN_FILE", file.c_str());
    EXPECT_TRUE(Client::connect({.endpoint = service.endpoint()}).ok());
  }
  {
    const Variable path("RCBD_TOKEN_FILE", "/no/such/file");
    EXPECT_EQ(Client::connect({.endpoint = service.endpoint()}).status().code(), Code::invalid_argument);
  }
  // A service that was started as 0.0.0.0:PORT keeps its token under that name; a stale one lies under another.
  const Endpoint own = parse_endpoint(service.endpoint()).value();
  write(token_path(own), "wrong\n");
  write(token_path(parse_endpoint("0.0.0.0:" + std::to_string(own.port)).value()), "of the directory\n");
  auto client = Client::connect({.endpoint = service.endpoint()});
  EXPECT_TRUE(client.ok());
  // A service that is started again has made a new one, which a client that connects again finds.
  write(token_path(own), "of the next start\n");
  EXPECT_FALSE(client->call("status", "{}", 0.2).ok());
  service.stop();
  tokens.erase(std::unique(tokens.begin(), tokens.end()), tokens.end());  // however often it was tried
  EXPECT_EQ(tokens, known);
}

// Who has taken the port of a service hears a hello that proves nothing elsewhere, and no request.
TEST(Connect, WhoDoesNotKnowTheTokenIsToldNothing) {
  using auth::Role;
  const std::string nonce = auth::random_nonce();
  protocol::Json asks_for_the_token = Peer::welcome();
  asks_for_the_token["authentication"] = "token";
  const std::vector<protocol::Json> welcomes{Peer::welcome(nonce), Peer::welcome(), asks_for_the_token,
                                             Peer::welcome("00"), Peer::welcome(std::string(64, '\n'))};
  const std::vector<std::function<protocol::Json(const Received&)>> proofs{
      [](const Received&) { return nullptr; },
      [&](const Received& hello) { return Peer::proof(Role::service, "another token", nonce, hello); },
      [&](const Received& hello) { return hello.json["proof"]; },  // sent back
      [&](const Received& hello) { return Peer::proof(Role::client, "secret", nonce, hello); },
      [&](const Received& hello) { return Peer::proof(Role::service, "secret", auth::random_nonce(), hello); },
      [&](const Received& hello) { return Peer::proof(Role::service, "secret", nonce, hello, "rank 0"); },
      [](const Received&) { return 7; }};
  for (const protocol::Json& welcome : welcomes)
    for (const auto& proof : proofs) {
      std::vector<Received> heard;
      FakeService service(
          [&](Peer& peer, int) {
            peer.send(protocol::FrameType::welcome, 0, welcome);
            while (const auto said = peer.receive()) {
              heard.push_back(*said);
              peer.reply(*said, {{"session", said->json["session"]}, {"ranks", 4}, {"proof", proof(*said)}});
            }
          },
          true);
      const auto client = Client::connect({.endpoint = service.endpoint(), .token = "secret"});
      ASSERT_FALSE(client.ok());
      EXPECT_EQ(client.status().code(), Code::not_authorised);
      EXPECT_NE(client.status().message().find("whoever listens at " + service.endpoint()), std::string::npos)
          << client.status().message();
      service.stop();
      EXPECT_EQ(heard.size(), welcome == welcomes[0] ? 1U : 0U) << welcome;
      for (const Received& said : heard) {
        EXPECT_EQ(said.type, protocol::FrameType::hello);
        EXPECT_EQ(said.json.dump().find("secret"), std::string::npos);
      }
    }
}

TEST(Call, RoundTripWithArraysAndNotices) {
  FakeService service(answering([](Peer& peer, const Received& request) {
    EXPECT_EQ(request.json["command"], "assign");
    EXPECT_EQ(request.json["scene"], "s");
    EXPECT_EQ(request.json["deadline_seconds"], 7.0);
    const std::vector<protocol::Array> arrays{protocol::array_of<std::int64_t>("id", "<i8", {5, -6}),
                                              {"part", "<i4", {0, 3}, {}}};
    peer.send(protocol::FrameType::notice, request.request, {{"notice", "waiting for 2"}});
    peer.reply(request, {{"epoch", 3}}, arrays, true);
  }));
  std::vector<std::string> notices;
  auto client = Client::connect(
      {.endpoint = service.endpoint(), .on_notice = [&](const std::string& text) { notices.push_back(text); }});
  ASSERT_TRUE(client.ok());
  for (int i = 0; i < 3; ++i) {
    const auto reply = client->call("assign", R"({"scene":"s"})", 7);
    ASSERT_TRUE(reply.ok()) << reply.status().message();
    EXPECT_NE(reply->json.find("\"epoch\":3"), std::string::npos);
    ASSERT_NE(reply->find("id"), nullptr);
    EXPECT_EQ(reply->find("id")->i8()[1], -6);
    EXPECT_TRUE(reply->find("id")->f8().empty()) << "another type";
    EXPECT_TRUE(reply->find("part")->i4().empty());
    EXPECT_EQ(reply->find("part")->shape, (std::vector<std::uint64_t>{0, 3}));
    EXPECT_EQ(reply->find("w"), nullptr);
  }
  EXPECT_EQ(notices, (std::vector<std::string>(3, "waiting for 2")));
  EXPECT_EQ(client->call("assign", "[1]").status().code(), Code::invalid_argument);
  EXPECT_EQ(client->call("push", "{}").status().code(), Code::unsupported);
}

TEST(Call, FailuresKeepCodeMessageAndHint) {
  FakeService service(answering([](Peer& peer, const Received& request) {
    peer.fail(request, {Code::not_found, "no scene 'x'", "rcbctl scene list"});
  }));
  auto client = Client::connect({.endpoint = service.endpoint()});
  ASSERT_TRUE(client.ok());
  const Status status = client->drop_scene("x");
  EXPECT_EQ(status.code(), Code::not_found);
  EXPECT_EQ(status.message(), "no scene 'x'");
  EXPECT_EQ(status.hint(), "rcbctl scene list");
  EXPECT_EQ(client->drop_scene("a/b").code(), Code::invalid_argument);
  EXPECT_EQ(client->open_scene("y").status().code(), Code::not_found);
}

TEST(Call, SceneOptionsTravel) {
  protocol::Json seen;
  FakeService service(answering([&](Peer& peer, const Received& request) {
    seen = request.json;
    peer.reply(request, protocol::Json::object());
  }));
  {
    auto client = Client::connect({.endpoint = service.endpoint()});
    ASSERT_TRUE(client.ok());
    SceneOptions options{.parts = 3, .dims = 2, .method = "bands-x", .part_sizes = {1, 2, 3}, .replace = true};
    options.tolerance = std::numeric_limits<double>::infinity();
    EXPECT_TRUE(client->create_scene("s", options).ok());
    options.tolerance = std::numeric_limits<double>::quiet_NaN();
    EXPECT_EQ(client->create_scene("s", options).code(), Code::invalid_argument);
  }
  service.stop();
  EXPECT_EQ(seen["command"], "scene.create");
  EXPECT_EQ(seen["tolerance"], "inf");
  EXPECT_EQ(seen["part_sizes"], (protocol::Json{1.0, 2.0, 3.0}));
  EXPECT_EQ(seen["dims"], 2);
  EXPECT_EQ(seen["replace"], true);
}

TEST(Call, SilentServiceMeetsTheDeadlineAndTheNextCallConnectsAgain) {
  FakeService service([](Peer& peer, int number) {
    if (!peer.greet(1)) return;
    while (const auto request = peer.receive())
      if (number > 0) peer.reply(*request, {{"number", number}});
  });
  auto client = Client::connect({.endpoint = service.endpoint()});
  ASSERT_TRUE(client.ok());
  const Status status = client->call("status", "{}", 0.01).status();
  EXPECT_EQ(status.code(), Code::deadline_exceeded) << status.message();
  EXPECT_NE(status.message().find("in time: status"), std::string::npos) << status.message();
  EXPECT_TRUE(client->call("status").ok());
}

// The caller, a program that was told to end for instance, is asked during every wait whether to go on.
TEST(Call, EndsWhenItsCallerWaitsNoLonger) {
  FakeService service([](Peer& peer, int number) {
    if (number == 0 && peer.greet(1)) peer.receive();  // no answer to the command, and no welcome after that
    peer.receive();
  });
  int asked = 0;
  bool go_on = true;
  ConnectOptions options{.endpoint = service.endpoint(), .deadline_seconds = 60};
  options.on_wait = [&] { return ++asked < 3 || go_on; };
  auto client = Client::connect(options);
  ASSERT_TRUE(client.ok()) << client.status().message();
  go_on = false;
  for (const char* waited_for : {"an answer", "a connection"}) {
    asked = 0;
    const Status status = client->call("status", "{}", 60).status();
    EXPECT_EQ(status.code(), Code::interrupted) << waited_for << ": " << status.message();
    EXPECT_EQ(asked, 3);
  }
}

TEST(Call, ReadsAreRepeatedOnALostConnectionAndOtherCommandsAreNot) {
  std::vector<std::string> sessions;
  FakeService service([&](Peer& peer, int number) {
    const auto hello = peer.greet(1);
    if (!hello) return;
    sessions.push_back(hello->json["session"].get<std::string>());
    while (const auto request = peer.receive()) {
      if (request->type == protocol::FrameType::goodbye) return;
      // Connection 0 ends without an answer to anything, 1 without one to a drop, 2 after its first answer.
      if (number == 0 || (number == 1 && request->json["command"] == "scene.drop")) return;
      peer.reply(*request, protocol::Json::object());
      if (number == 2) return;
    }
  });
  {
    auto client = Client::connect({.endpoint = service.endpoint()});
    ASSERT_TRUE(client.ok());
    EXPECT_TRUE(client->call("status").ok());
    const Status status = client->drop_scene("s");
    EXPECT_EQ(status.code(), Code::unavailable);
    EXPECT_NE(status.message().find("whether 'scene.drop' was done is not known"), std::string::npos)
        << status.message();
    EXPECT_TRUE(client->drop_scene("s").ok());
    EXPECT_TRUE(client->call("status").ok());
  }
  service.stop();
  ASSERT_EQ(sessions.size(), 4U);
  EXPECT_EQ(sessions[0], sessions[3]);
}

TEST(Call, ServiceThatIsGoneIsUnavailable) {
  auto service = std::make_unique<FakeService>([](Peer& peer, int) {
    if (peer.greet(1)) peer.receive();
  });
  auto client = Client::connect({.endpoint = service->endpoint()});
  ASSERT_TRUE(client.ok());
  std::thread([&] { EXPECT_EQ(client->call("status", "{}", 0.2).status().code(), Code::unavailable); }).join();
  service.reset();
  EXPECT_EQ(client->call("status", "{}", 0.2).status().code(), Code::unavailable);
}

// Whatever comes back, a call ends with a Status.
TEST(Call, HostileAnswersNeverCrash) {
  const std::uint64_t seed = std::random_device{}();
  SCOPED_TRACE("seed " + std::to_string(seed));
  Random random(seed);
  const std::vector<protocol::Array> arrays{{"id", "<i8", {4}, std::string(32, '\1')}};
  FakeService service([&](Peer& peer, int) {
    const bool greeting = random.below(4) == 0;
    if (!greeting && !peer.greet(1)) return;
    std::optional<Received> request;
    if (!greeting && !(request = peer.receive())) return;
    std::string bytes =
        protocol::frame(greeting ? protocol::FrameType::welcome : protocol::FrameType::reply,
                        greeting ? 0 : request->request, greeting ? Peer::welcome() : protocol::Json{{"a", 1}},
                        greeting ? std::vector<protocol::Array>{} : arrays, true);
    switch (random.below(4)) {
      case 0:
        bytes.resize(random.below(bytes.size()));
        break;
      case 1:
        bytes[random.below(bytes.size())] ^= static_cast<char>(1U << random.below(8));
        break;
      case 2:
        for (char& c : bytes) c = static_cast<char>(random.below(256));
        break;
      default: {  // right checksum, wrong lengths
        const std::uint64_t bulk_bytes = random.next() >> random.below(64);
        bytes = protocol::head(protocol::FrameType::reply, request ? request->request : 0,
                               R"({"arrays":[{"name":"x","dtype":"<f8","shape":[281474976710656,4096]}]})", bulk_bytes);
      }
    }
    peer.send_bytes(bytes);
  });
  for (int round = 0; round < 150; ++round) {
    auto client = Client::connect({.endpoint = service.endpoint(), .deadline_seconds = 20});
    if (!client.ok()) {
      EXPECT_FALSE(client.status().message().empty());
      continue;
    }
    const auto reply = client->call("rebalance", "{}", 20);
    EXPECT_FALSE(reply.ok()) << reply->json;
  }
}

TEST(Positions, Views) {
  const double xyz[] = {1, 2, 3, 4, 5, 6};
  const Positions rows = Positions::rows(xyz, 2, 3);
  EXPECT_EQ(rows.stride, 3U);
  EXPECT_EQ(*rows.axis[2], 3);
  const double* list[] = {xyz, xyz + 2};
  const Positions axes = Positions::axes(list, 2);
  EXPECT_EQ(axes.dims, 2);
  EXPECT_EQ(axes.stride, 1U);
  EXPECT_EQ(axes.axis[1], xyz + 2);
  EXPECT_EQ(axes.axis[2], nullptr);
}

}  // namespace
}  // namespace rcb::client
