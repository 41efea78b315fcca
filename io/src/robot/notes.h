// Collects the report of a reader.
#pragma once

#include "xml.h"

namespace novaphy::detail {

class Notes {
 public:
  Notes(const XmlFile& file, Unsupported unsupported) : file_(file), unsupported_(unsupported) {}

  void read(const char* kind, int32_t count = 1) { report_.read[kind] += count; }
  void mended(const Element& e, std::string text) {
    report_.mended.push_back(file_.note(e, std::move(text)));
  }
  void ignored(const Element& e, std::string text) {
    report_.ignored.push_back(file_.note(e, std::move(text)));
  }
  // Notes an element that only the display needs and that is left out, because its file is missing
  // or its kind is not read.
  void missing(const Element& e, std::string text) {
    report_.left_out.push_back(file_.note(e, std::move(text)));
  }
  // Notes an unsupported part, or throws ErrorKind::NotImplemented if unsupported parts are errors.
  // `text` describes the part.
  void left_out(const Element& e, const std::string& text) {
    if (unsupported_ == Unsupported::Error)
      file_.refuse(e, text + " (unsupported=\"warn\" leaves it out)", ErrorKind::NotImplemented);
    report_.left_out.push_back(file_.note(e, text));
  }
  // Adds the notes of another file that is a part of this one.
  void add(RobotReport other) {
    for (const auto& [kind, count] : other.read) report_.read[kind] += count;
    const auto append = [](auto& to, auto& from) { to.insert(to.end(), from.begin(), from.end()); };
    append(report_.mended, other.mended);
    append(report_.left_out, other.left_out);
    append(report_.ignored, other.ignored);
  }
  RobotReport take() { return std::move(report_); }

 private:
  const XmlFile& file_;
  const Unsupported unsupported_;
  RobotReport report_;
};

// Sets the report of a result, and its warnings, which are the combined notes of the report.
void set_report(RobotImport& result, RobotReport report);

}  // namespace novaphy::detail
