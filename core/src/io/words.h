// A text as words between white space, with the line of each: for readers of text formats. Every
// error is ErrorKind::Value and says "<where>:<line>: expected ..., got ...".
#pragma once

#include <cstdint>
#include <string>
#include <string_view>

#include "novaphy/core/error.h"

namespace novaphy::detail {

class Words {
 public:
  // `text` must outlive this.
  Words(std::string_view text, std::string where) : text_(text), where_(std::move(where)) {}

  // `expected` says what should stand here, for the message: "a node tag".
  std::string_view next(std::string_view expected);
  int64_t integer(std::string_view expected);
  double number(std::string_view expected);
  // How many things follow: not negative, and no more than the rest of the text can hold, so that a
  // broken number cannot ask for all memory.
  size_t count(std::string_view expected);
  // The rest of this line and `lines` more; blank ones do not count.
  void skip_lines(size_t lines, std::string_view expected);

  bool at_end();
  size_t line() const { return line_; }  // of the last word

  template <class... Parts>
  void check(bool condition, const Parts&... parts) const {
    check_at(line_, condition, parts...);
  }
  template <class... Parts>
  void check_at(size_t line, bool condition, const Parts&... parts) const {
    require(condition, ErrorKind::Value, where_, ":", line, ": ", parts...);
  }
  const std::string& where() const { return where_; }

 private:
  void skip_space();

  std::string_view text_;
  std::string where_;
  size_t at_ = 0, line_ = 1;
};

// A word of a file for a message: short, and without what a terminal would act on.
std::string quoted(std::string_view word);

}  // namespace novaphy::detail
