#include "gld/base/error.h"
#include "gld/base/interrupt.h"
#include "gld/distributed/process_team.h"
#include "gld/distributed/signs_of_life.h"
#include "gld/report/provenance.h"
#include "gld/tensors/torch_version.h"

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <csignal>
#include <cstring>
#include <exception>
#include <future>
#include <memory>
#include <optional>
#include <thread>
#include <utility>

#include <torch/autograd.h>
#include <torch/csrc/distributed/c10d/PrefixStore.hpp>
#include <torch/csrc/distributed/c10d/ProcessGroupGloo.hpp>
#include <torch/csrc/distributed/c10d/TCPStore.hpp>

#include <arpa/inet.h>
#include <fmt/format.h>
#include <fmt/ranges.h>
#include <netdb.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

namespace gld {
namespace {

using StorePointer = c10::intrusive_ptr<c10d::Store>;

// Of collectives: the signs of life end a process that waits for one that is gone.
constexpr std::chrono::hours kCollectiveTimeout(24 * 30);

std::string first_line(const std::string& text) { return text.substr(0, text.find('\n')); }

std::string endpoint(const ProcessPlacement& placement) {
  return placement.master_address + ":" + std::to_string(placement.master_port);
}

bool holds_the_store(const ProcessPlacement& placement) {
  return placement.rank == 0 && !placement.store_is_hosted;
}

StorePointer connect_to_store(const ProcessPlacement& placement, bool as_server) {
  c10d::TCPStoreOptions options;
  options.port = static_cast<uint16_t>(placement.master_port);
  options.isServer = as_server;
  options.waitWorkers = false;
  options.timeout = std::chrono::milliseconds(static_cast<int64_t>(1000 * placement.join_seconds));
  try {
    const StorePointer store = c10::make_intrusive<c10d::TCPStore>(placement.master_address, options);
    return c10::make_intrusive<c10d::PrefixStore>("gld/" + placement.attempt, store);
  } catch (const std::exception& error) {
    const std::string found = first_line(error.what());
    if (as_server) {
      fail({endpoint(placement), "a free port for the store of rank 0", found,
            "choose another with --processes.master-port (MASTER_PORT), the same for every process"});
    }
    fail({endpoint(placement),
          fmt::format("the store of rank 0 within {:.0f} s, of LibTorch {}", placement.join_seconds,
                      torch_version()),
          found, "start rank 0 too, and correct --processes.master-address and --processes.master-port"});
  }
}

struct SocketOnce {
  int number = -1;
  ~SocketOnce() {
    if (number >= 0) ::close(number);
  }
};

// Returns the address of this machine from which the master is reached, as a number. Nothing is sent.
std::string address_towards(const ProcessPlacement& placement) {
  addrinfo hints = {};
  hints.ai_socktype = SOCK_DGRAM;
  addrinfo* list = nullptr;
  const int problem = ::getaddrinfo(placement.master_address.c_str(),
                                    std::to_string(placement.master_port).c_str(), &hints, &list);
  if (problem != 0) {
    fail({"--processes.master-address", "an address or a name that can be resolved",
          "'" + placement.master_address + "' (" + ::gai_strerror(problem) + ")",
          "give the address of the machine of rank 0"});
  }
  std::string found;
  for (const addrinfo* item = list; item != nullptr && found.empty(); item = item->ai_next) {
    const SocketOnce socket{::socket(item->ai_family, SOCK_DGRAM, 0)};
    if (socket.number < 0 || ::connect(socket.number, item->ai_addr, item->ai_addrlen) != 0) continue;
    sockaddr_storage own = {};
    socklen_t size = sizeof(own);
    char text[NI_MAXHOST];
    auto* address = reinterpret_cast<sockaddr*>(&own);
    if (::getsockname(socket.number, address, &size) == 0 &&
        ::getnameinfo(address, size, text, sizeof(text), nullptr, 0, NI_NUMERICHOST) == 0) {
      found = text;
    }
  }
  ::freeaddrinfo(list);
  if (found.empty()) {
    fail({"--processes.master-address", "an address that this machine has a way to",
          "none to '" + placement.master_address + "'", "give the address of the machine of rank 0"});
  }
  return found;
}

bool is_loopback(const std::string& address) { return address.rfind("127.", 0) == 0 || address == "::1"; }

void put(c10d::Store& store, const std::string& key, const std::string& text) {
  store.set(key, std::vector<uint8_t>(text.begin(), text.end()));
}

std::string read(c10d::Store& store, const std::string& key) {
  const auto bytes = store.get(key);
  return {bytes.begin(), bytes.end()};
}

// What processes must agree on before they connect to each other: everyone's address, in the order of ranks.
class Meeting {
 public:
  Meeting(const ProcessPlacement& placement, StorePointer store)
      : placement_(placement), store_(std::move(store)) {}

  std::vector<std::string> addresses() {
    const std::string rank = std::to_string(placement_.rank);
    const std::string count = std::to_string(placement_.count);
    const auto agreed = store_->compareSet("count", {}, std::vector<uint8_t>(count.begin(), count.end()));
    const std::string first(agreed.begin(), agreed.end());
    if (first != count) {
      give_up({"--processes.count", "the same number of processes everywhere",
               count + " at rank " + rank + " and " + first + " at the first that came",
               "give every process the same count (WORLD_SIZE)"});
    }
    if (store_->add("taken/" + rank, 1) != 1) {
      give_up({"--processes.rank", "a rank of its own for every process", "rank " + rank + " twice",
               "correct RANK, and wait until an earlier run at " + endpoint(placement_) + " has ended"});
    }
    put(*store_, "address/" + rank, address_towards(placement_));
    put(*store_, "version/" + rank, program_version() + " with LibTorch " + torch_version());
    put(*store_, "here/" + rank, "yes");
    wait_for_all();
    check_versions();
    std::vector<std::string> addresses;
    for (int64_t other = 0; other < placement_.count; ++other) {
      addresses.push_back(read(*store_, "address/" + std::to_string(other)));
    }
    check_addresses(addresses);
    return addresses;
  }

 private:
  // The others hear of it too; whoever holds the store lets them.
  [[noreturn]] void give_up(const ErrorParts& parts) {
    say_ended(*store_, parts.where + ": " + parts.found);
    if (holds_the_store(placement_)) std::this_thread::sleep_for(std::chrono::seconds(1));
    fail(parts);
  }

  void wait_for_all() {
    const auto begun = std::chrono::steady_clock::now();
    const auto rest = std::chrono::milliseconds(50);
    for (;;) {
      std::vector<int64_t> missing;
      for (int64_t other = 0; other < placement_.count; ++other) {
        if (!store_->check({"here/" + std::to_string(other)})) missing.push_back(other);
      }
      if (missing.empty()) return;
      if (store_->check({kEndedKey})) {
        fail({"rank " + std::to_string(placement_.rank),
              fmt::format("{} processes to join", placement_.count), read(*store_, kEndedKey),
              "see what the other processes said"});
      }
      const double waited = std::chrono::duration<double>(std::chrono::steady_clock::now() - begun).count();
      if (waited > placement_.join_seconds) {
        give_up({endpoint(placement_), fmt::format("{} processes within {:.0f} s", placement_.count, waited),
                 fmt::format("none of rank {}", fmt::join(missing, ", ")),
                 "start those too, or correct --processes.count (WORLD_SIZE)"});
      }
      std::this_thread::sleep_for(rest);
    }
  }

  void check_versions() {
    const std::string first = read(*store_, "version/0");
    for (int64_t other = 1; other < placement_.count; ++other) {
      const std::string version = read(*store_, "version/" + std::to_string(other));
      if (version == first) continue;
      give_up({"rank " + std::to_string(other), first + ", as rank 0 is", version,
               "start the same program everywhere"});
    }
  }

  void check_addresses(const std::vector<std::string>& addresses) {
    const auto local = std::count_if(addresses.begin(), addresses.end(), is_loopback);
    if (local == 0 || local == placement_.count) return;
    const auto at = std::find_if(addresses.begin(), addresses.end(), is_loopback) - addresses.begin();
    give_up({"--processes.master-address", "an address that is of the network on every machine",
             fmt::format("'{}', which is {} at rank {}, where no other machine can reach it",
                         placement_.master_address, addresses[static_cast<size_t>(at)], at),
             "give the machine's address on the network, or correct its /etc/hosts"});
  }

  const ProcessPlacement& placement_;
  StorePointer store_;
};

// LibTorch would say it in its own words, and in lines of its log.
void require_free_port(const ProcessPlacement& placement) {
  const SocketOnce socket{::socket(AF_INET6, SOCK_STREAM, 0)};
  if (socket.number < 0) return;  // a machine without IPv6
  const int yes = 1, no = 0;
  ::setsockopt(socket.number, SOL_SOCKET, SO_REUSEADDR, &yes, sizeof(yes));
  ::setsockopt(socket.number, IPPROTO_IPV6, IPV6_V6ONLY, &no, sizeof(no));
  sockaddr_in6 address = {};
  address.sin6_family = AF_INET6;
  address.sin6_addr = in6addr_any;
  address.sin6_port = htons(static_cast<uint16_t>(placement.master_port));
  if (::bind(socket.number, reinterpret_cast<const sockaddr*>(&address), sizeof(address)) == 0) return;
  if (errno != EADDRINUSE && errno != EACCES) return;
  fail({endpoint(placement), "a free port for the store of rank 0",
        std::to_string(placement.master_port) + " (" + std::strerror(errno) + ")",
        "choose another with --processes.master-port (MASTER_PORT), the same for every process"});
}

// Something else that listens where the store of rank 0 should.
ErrorParts not_a_store(const ProcessPlacement& placement) {
  return {endpoint(placement), "the store of rank 0, of LibTorch " + torch_version(),
          "something else that listens there",
          "correct --processes.master-address and --processes.master-port"};
}

// A store says nothing until it is asked. What talks first would end this process: LibTorch 1.13 reads its bytes in a
// thread of its own, as a size, and nobody catches what that throws. What cannot be reached yet is left to LibTorch.
void refuse_what_talks_first(const ProcessPlacement& placement) {
  constexpr int kMilliseconds = 200;
  addrinfo hints = {};
  hints.ai_socktype = SOCK_STREAM;
  addrinfo* list = nullptr;
  if (::getaddrinfo(placement.master_address.c_str(), std::to_string(placement.master_port).c_str(), &hints,
                    &list) != 0) {
    return;
  }
  bool talks = false;
  for (const addrinfo* item = list; item != nullptr && !talks; item = item->ai_next) {
    const SocketOnce socket{::socket(item->ai_family, SOCK_STREAM | SOCK_NONBLOCK, 0)};
    if (socket.number < 0) continue;
    if (::connect(socket.number, item->ai_addr, item->ai_addrlen) != 0 && errno != EINPROGRESS) continue;
    pollfd connected = {socket.number, POLLOUT, 0}, readable = {socket.number, POLLIN, 0};
    if (::poll(&connected, 1, kMilliseconds) <= 0 || ::poll(&readable, 1, kMilliseconds) <= 0) continue;
    char byte = 0;
    talks = ::recv(socket.number, &byte, 1, 0) == 1;
  }
  ::freeaddrinfo(list);
  if (talks) fail(not_a_store(placement));
}

// What the processes have agreed on.
struct Joined {
  StorePointer store;
  StorePointer store_of_life;
  std::vector<std::string> addresses;
};

Joined join(const ProcessPlacement& placement) {
  if (holds_the_store(placement)) {
    require_free_port(placement);
  } else {
    refuse_what_talks_first(placement);
  }
  Joined joined;
  joined.store = connect_to_store(placement, holds_the_store(placement));
  joined.addresses = Meeting(placement, joined.store).addresses();
  joined.store_of_life = connect_to_store(placement, false);
  return joined;
}

// Does join() within its time, whatever answers at the address: LibTorch waits without an end for one that says
// nothing, and takes the bytes of another protocol for sizes. A thread that waits for such a one is left behind, for
// the process ends with the error.
Joined join_in_time(const ProcessPlacement& placement) {
  // Connecting and the meeting may each take that long, and say better what is missing.
  const auto patience = std::chrono::duration<double>(2 * placement.join_seconds + 2);
  const auto promise = std::make_shared<std::promise<Joined>>();
  auto future = promise->get_future();
  std::thread([promise, placement] {
    try {
      promise->set_value(join(placement));
    } catch (...) {
      promise->set_exception(std::current_exception());
    }
  }).detach();
  const auto end = std::chrono::steady_clock::now() + patience;
  while (future.wait_for(std::chrono::milliseconds(100)) != std::future_status::ready) {
    stop_if_interrupted("joining the other processes was stopped");
    if (std::chrono::steady_clock::now() > end) fail(not_a_store(placement));
  }
  try {
    return future.get();
  } catch (const Error&) {
    throw;
  } catch (const std::exception&) {
    fail(not_a_store(placement));
  }
}

class GlooTeam final : public ProcessTeam {
 public:
  explicit GlooTeam(const ProcessPlacement& placement) : placement_(placement) {
    const Joined joined = join_in_time(placement);
    store_ = joined.store;
    const auto& addresses = joined.addresses;
    const std::string& own = addresses[static_cast<size_t>(placement.rank)];
    local_count_ = std::count(addresses.begin(), addresses.end(), own);
    LifePlan plan;
    plan.rank = placement.rank;
    plan.count = placement.count;
    plan.store = endpoint(placement) + (placement.store_is_hosted ? ", of torchrun" : ", of rank 0");
    plan.holds_the_store = holds_the_store(placement);
    life_.emplace(joined.store_of_life, plan);
    const auto options = c10d::ProcessGroupGloo::Options::create(kCollectiveTimeout);
    try {
      options->devices.push_back(c10d::ProcessGroupGloo::createDeviceForHostname(own));
      group_ = c10::make_intrusive<c10d::ProcessGroupGloo>(
          c10::make_intrusive<c10d::PrefixStore>("gloo", store_), static_cast<int>(placement.rank),
          static_cast<int>(placement.count), options);
    } catch (const std::exception& error) {
      refuse(error);
    }
  }

  ~GlooTeam() override {
    // Where an error unwinds, the others are told that this process leaves them.
    const bool failed = std::uncaught_exceptions() > 0;
    try {
      if (!finished_ && !failed) finish();
      life_->stop("rank " + std::to_string(rank()) + " ended with an error of its own");
      group_.reset();
      leave();
    } catch (const std::exception&) {
      // There is nobody left to tell.
    }
  }

  int64_t rank() const override { return placement_.rank; }
  int64_t count() const override { return placement_.count; }
  int64_t local_count() const override { return local_count_; }

  std::vector<std::string> gather(const std::string& mine) override {
    const auto length = torch::full({1}, static_cast<int64_t>(mine.size()), torch::kInt64);
    const auto lengths = gather_tensors(length);
    int64_t longest = 1;
    for (const auto& item : lengths) longest = std::max(longest, item.item<int64_t>());
    const auto bytes = torch::zeros({longest}, torch::kUInt8);
    std::copy(mine.begin(), mine.end(), reinterpret_cast<char*>(bytes.data_ptr<uint8_t>()));
    std::vector<std::string> texts;
    const auto all = gather_tensors(bytes);
    for (size_t other = 0; other < all.size(); ++other) {
      texts.emplace_back(reinterpret_cast<const char*>(all[other].data_ptr<uint8_t>()),
                         static_cast<size_t>(lengths[other].item<int64_t>()));
    }
    return texts;
  }

  void add_at_owners(const torch::Tensor& given, torch::Tensor& owned_sum) override {
    const torch::NoGradGuard no_grad;
    const int64_t piece = piece_length(given.numel());
    auto sent = torch::zeros({count(), piece}, torch::kFloat32);
    sent.view({-1}).narrow(0, 0, given.numel()).copy_(given);
    auto received = torch::empty_like(sent);
    std::vector<int64_t> equal;
    run([&] { return group_->alltoall_base(received, sent, equal, equal); });
    for (int64_t other = 0; other < count(); ++other) owned_sum.add_(received[other].to(owned_sum.device()));
  }

  void gather_pieces(const torch::Tensor& owned, torch::Tensor& whole) override {
    const torch::NoGradGuard no_grad;
    const auto pieces = gather_tensors(owned.cpu().contiguous());
    const int64_t length = owned.numel();
    for (int64_t other = 0; other < count(); ++other) {
      const int64_t begin = std::min(other * length, whole.numel());
      const int64_t end = std::min(begin + length, whole.numel());
      whole.narrow(0, begin, end - begin).copy_(pieces[static_cast<size_t>(other)].narrow(0, 0, end - begin));
    }
  }

  void broadcast(torch::Tensor& tensor, int64_t from) override {
    const torch::NoGradGuard no_grad;
    std::vector<torch::Tensor> sent = {tensor.cpu().contiguous()};
    c10d::BroadcastOptions options;
    options.rootRank = from;
    run([&] { return group_->broadcast(sent, options); });
    if (sent.front().data_ptr() != tensor.data_ptr()) tensor.copy_(sent.front());
  }

  void finish() override {
    run([&] { return group_->barrier(); });
    life_->stop("");
    finished_ = true;
  }

  double take_communication_seconds() override { return std::exchange(communication_seconds_, 0.0); }

 private:
  template <class Collective>
  void run(Collective&& collective) {
    const auto begun = std::chrono::steady_clock::now();
    try {
      collective()->wait();
    } catch (const std::exception& error) {
      refuse(error);
    }
    communication_seconds_ += std::chrono::duration<double>(std::chrono::steady_clock::now() - begun).count();
  }

  // This happens mostly because another process is gone, which the signs of life say better.
  [[noreturn]] void refuse(const std::exception& error) {
    const std::string found = first_line(error.what());
    life_->wait_for_verdict();
    fail({"rank " + std::to_string(rank()), fmt::format("connections to all {} processes", count()), found,
          "see what the others said, and continue with --resume"});
  }

  std::vector<torch::Tensor> gather_tensors(const torch::Tensor& mine) {
    std::vector<torch::Tensor> inputs = {mine};
    std::vector<std::vector<torch::Tensor>> outputs(1);
    for (int64_t other = 0; other < count(); ++other) outputs.front().push_back(torch::empty_like(mine));
    run([&] { return group_->allgather(outputs, inputs); });
    return outputs.front();
  }

  // The store goes last: with it the others would lose what ends them in order.
  void leave() {
    const auto begun = std::chrono::steady_clock::now();
    store_->add("left", 1);
    if (!holds_the_store(placement_)) return;
    const auto patience = std::chrono::seconds(3);
    while (store_->add("left", 0) < count() && std::chrono::steady_clock::now() - begun < patience) {
      std::this_thread::sleep_for(std::chrono::milliseconds(20));
    }
  }

  ProcessPlacement placement_;
  StorePointer store_;
  int64_t local_count_ = 1;
  std::optional<SignsOfLife> life_;
  c10::intrusive_ptr<c10d::ProcessGroupGloo> group_;
  double communication_seconds_ = 0;
  bool finished_ = false;
};

}  // namespace

std::vector<std::string> process_engines() { return {"gloo"}; }

std::unique_ptr<ProcessTeam> join_processes(const ProcessPlacement& placement) {
  // A write to a process that is gone would end this one by SIGPIPE before it can say so. It is ignored for the whole
  // process, since gloo writes from threads of its own.
  std::signal(SIGPIPE, SIG_IGN);
  return std::make_unique<GlooTeam>(placement);
}

}  // namespace gld
