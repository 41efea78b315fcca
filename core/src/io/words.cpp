#include "words.h"

#include <charconv>

namespace novaphy::detail {
namespace {

bool is_space(char c) { return c == ' ' || (c >= '\t' && c <= '\r'); }

}  // namespace

std::string quoted(std::string_view word) {
  constexpr size_t kLongest = 40;
  std::string text = "\"";
  for (const char c : word.substr(0, kLongest)) text += c >= ' ' && c <= '~' ? c : '?';
  return text + (word.size() > kLongest ? "...\"" : "\"");
}

void Words::skip_space() {
  for (; at_ < text_.size() && is_space(text_[at_]); ++at_)
    if (text_[at_] == '\n') ++line_;
}

bool Words::at_end() {
  skip_space();
  return at_ == text_.size();
}

std::string_view Words::next(std::string_view expected) {
  check(!at_end(), "expected ", expected, ", got the end of the file");
  const size_t begin = at_;
  while (at_ < text_.size() && !is_space(text_[at_])) ++at_;
  return text_.substr(begin, at_ - begin);
}

int64_t Words::integer(std::string_view expected) {
  const std::string_view word = next(expected);
  int64_t value = 0;
  const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), value);
  check(error == std::errc() && end == word.data() + word.size(), "expected ", expected, ", got ",
        quoted(word));
  return value;
}

double Words::number(std::string_view expected) {
  const std::string_view word = next(expected);
  double value = 0.0;
  const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), value);
  check(error == std::errc() && end == word.data() + word.size(), "expected ", expected, ", got ",
        quoted(word));
  return value;
}

size_t Words::count(std::string_view expected) {
  const int64_t value = integer(expected);
  const size_t room = (text_.size() - at_) / 2;  // each number takes at least a digit and a space
  check(value >= 0 && static_cast<uint64_t>(value) <= room, "expected ", expected, ", 0 to ", room,
        " in a file of this length, got ", value);
  return static_cast<size_t>(value);
}

void Words::skip_lines(size_t lines, std::string_view expected) {
  for (;;) {
    while (at_ < text_.size() && text_[at_] != '\n') ++at_;
    if (lines == 0) return;
    next(expected);
    --lines;
  }
}

}  // namespace novaphy::detail
