// Words: splits a text at white space and tracks the line of each word, for readers of text
// formats. Every error is ErrorKind::Value with the message "<where>:<line>: expected ..., got
// ...".
#pragma once

#include <cstdint>
#include <string>
#include <string_view>

#include "novaphy/core/error.h"

namespace novaphy::detail {

class Words {
 public:
  // `text` must outlive this object.
  Words(std::string_view text, std::string where) : text_(text), where_(std::move(where)) {}

  // Functions that read the next word. `expected` describes the word for the error message, for
  // example "a node tag".
  std::string_view next(std::string_view expected);
  int64_t integer(std::string_view expected);
  double number(std::string_view expected);
  // Reads the number of items that follow. The number must be >= 0 and fit into the rest of the
  // text, so that a corrupt number cannot request huge memory.
  size_t count(std::string_view expected);
  // Skips the rest of this line and `lines` more lines. Blank lines are not counted.
  void skip_lines(size_t lines, std::string_view expected);

  bool at_end();
  size_t line() const { return line_; }  // line of the last word

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

// Quotes a word of a file for an error message: shortened, with control characters replaced.
std::string quoted(std::string_view word);

}  // namespace novaphy::detail
