#include "urdfdom.h"

#include <console_bridge/console.h>
#include <urdf_parser/urdf_parser.h>

#include <mutex>

#include "novaphy/core/error.h"

namespace novaphy::detail {
namespace {

// Stores the first error message instead of printing messages.
class Listener : public console_bridge::OutputHandler {
 public:
  void log(const std::string& text, console_bridge::LogLevel level, const char*, int) override {
    if (level >= console_bridge::CONSOLE_BRIDGE_LOG_ERROR && error.empty()) error = text;
  }
  std::string error;
};

// Sends messages of urdfdom to a Listener for the lifetime of the object. The process has only one
// message handler, so the object holds a lock.
class Listening {
 public:
  explicit Listening(Listener& listener) : lock_(mutex()) {
    console_bridge::useOutputHandler(&listener);
  }
  ~Listening() { console_bridge::restorePreviousOutputHandler(); }
  Listening(const Listening&) = delete;
  Listening& operator=(const Listening&) = delete;

 private:
  static std::mutex& mutex() {
    static std::mutex one;
    return one;
  }
  std::lock_guard<std::mutex> lock_;
};

}  // namespace

std::shared_ptr<urdf::ModelInterface> parse_urdf(const std::string& where,
                                                 const std::string& text) {
  Listener listener;
  std::shared_ptr<urdf::ModelInterface> model;
  {
    const Listening listening(listener);
    try {
      model = urdf::parseURDF(text);
    } catch (const std::exception& error) {
      if (listener.error.empty()) listener.error = error.what();
    }
  }
  require(model != nullptr && listener.error.empty(), ErrorKind::Value, where,
          ":1: <robot>: ", listener.error.empty() ? "urdfdom refuses it" : listener.error);
  return model;
}

void take_apart(urdf::ModelInterface& model) {
  for (auto& [name, link] : model.links_) {
    link->child_links.clear();
    link->child_joints.clear();
  }
}

}  // namespace novaphy::detail
