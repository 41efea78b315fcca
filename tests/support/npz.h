// Reads NumPy .npz files: a ZIP archive of .npy arrays, stored or deflated. For tests.
#pragma once

#include <zlib.h>

#include <cstdint>
#include <cstring>
#include <fstream>
#include <iterator>
#include <map>
#include <numeric>
#include <span>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <vector>

namespace novaphy::testing {

struct NpyArray {
  std::string descr;  // "<f4", "<i4", ...
  std::vector<size_t> shape;
  std::vector<unsigned char> bytes;

  size_t size() const {
    return std::accumulate(shape.begin(), shape.end(), size_t{1}, std::multiplies<>());
  }
  // Returns the elements as T: the array's type, or a struct of it (Vec3f over "<f4").
  template <class T>
  std::span<const T> as() const {
    if (bytes.size() % sizeof(T) != 0)
      throw std::runtime_error("npz: the array is no sequence of these elements");
    return {reinterpret_cast<const T*>(bytes.data()), bytes.size() / sizeof(T)};
  }
  template <class T>
  T scalar() const {
    if (size() != 1 || bytes.size() != sizeof(T))
      throw std::runtime_error("npz: expected one element");
    T value;
    std::memcpy(&value, bytes.data(), sizeof(T));
    return value;
  }
};

class Npz {
 public:
  explicit Npz(const std::string& path) : path_(path) {
    std::ifstream file(path, std::ios::binary);
    if (!file) throw std::runtime_error("npz: missing file " + path);
    data_.assign(std::istreambuf_iterator<char>(file), {});
    read_directory();
  }

  bool contains(const std::string& name) const { return arrays_.contains(name); }
  const NpyArray& operator[](const std::string& name) const {
    const auto at = arrays_.find(name);
    if (at == arrays_.end()) throw std::runtime_error("npz: " + path_ + " has no array " + name);
    return at->second;
  }

 private:
  template <class T>
  T read(size_t offset) const {
    static_assert(std::is_unsigned_v<T>);
    if (offset + sizeof(T) > data_.size())
      throw std::runtime_error("npz: " + path_ + " ends early");
    T value;  // little endian, as the tested machines are
    std::memcpy(&value, data_.data() + offset, sizeof(T));
    return value;
  }

  void read_directory() {
    constexpr uint32_t kEnd = 0x06054b50, kEntry = 0x02014b50;
    size_t end = data_.size() < 22 ? 0 : data_.size() - 22;
    while (end > 0 && read<uint32_t>(end) != kEnd) --end;
    if (data_.size() < 22 || read<uint32_t>(end) != kEnd)
      throw std::runtime_error("npz: " + path_ + " is no ZIP file");
    const auto entries = read<uint16_t>(end + 10);
    size_t at = read<uint32_t>(end + 16);
    for (unsigned i = 0; i < entries; ++i) {
      if (read<uint32_t>(at) != kEntry)
        throw std::runtime_error("npz: " + path_ + " has a bad directory");
      const auto method = read<uint16_t>(at + 10);
      const size_t packed = read<uint32_t>(at + 20), size = read<uint32_t>(at + 24);
      const size_t name_length = read<uint16_t>(at + 28);
      const size_t extra = read<uint16_t>(at + 30), comment = read<uint16_t>(at + 32);
      const size_t local = read<uint32_t>(at + 42);
      std::string name(data_.data() + at + 46, name_length);
      if (name.ends_with(".npy")) name.resize(name.size() - 4);
      const size_t begin = local + 30 + read<uint16_t>(local + 26) + read<uint16_t>(local + 28);
      arrays_[name] = parse(unpack(method, begin, packed, size));
      at += 46 + name_length + extra + comment;
    }
  }

  std::vector<unsigned char> unpack(unsigned method, size_t begin, size_t packed, size_t size) {
    if (begin + packed > data_.size()) throw std::runtime_error("npz: " + path_ + " ends early");
    std::vector<unsigned char> out(size);
    auto* source = reinterpret_cast<unsigned char*>(data_.data() + begin);
    if (method == 0) {
      std::memcpy(out.data(), source, size);
      return out;
    }
    z_stream stream{};
    if (method != 8 || inflateInit2(&stream, -MAX_WBITS) != Z_OK)
      throw std::runtime_error("npz: unknown packing");
    stream.next_in = source;
    stream.avail_in = static_cast<unsigned>(packed);
    stream.next_out = out.data();
    stream.avail_out = static_cast<unsigned>(size);
    const int code = inflate(&stream, Z_FINISH);
    inflateEnd(&stream);
    if (code != Z_STREAM_END || stream.total_out != size)
      throw std::runtime_error("npz: " + path_ + " is damaged");
    return out;
  }

  static NpyArray parse(const std::vector<unsigned char>& file) {
    if (file.size() < 12 || std::memcmp(file.data(), "\x93NUMPY", 6) != 0)
      throw std::runtime_error("npz: no .npy entry");
    const bool v1 = file[6] == 1;
    const size_t start = v1 ? 10 : 12;
    size_t length = file[8] + 256u * file[9];
    if (!v1) length += (size_t{file[10]} << 16) + (size_t{file[11]} << 24);
    if (start + length > file.size()) throw std::runtime_error("npz: .npy header ends early");
    const std::string header(reinterpret_cast<const char*>(file.data()) + start, length);
    if (header.find("'fortran_order': False") == std::string::npos)
      throw std::runtime_error("npz: Fortran order");
    NpyArray array;
    const size_t descr = header.find("'descr': '") + 10;
    array.descr = header.substr(descr, header.find('\'', descr) - descr);
    size_t at = header.find("'shape': (") + 10;
    const size_t close = header.find(')', at);
    while (at < close) {
      if (header[at] >= '0' && header[at] <= '9') {
        size_t used = 0;
        array.shape.push_back(std::stoull(header.substr(at, close - at), &used));
        at += used;
      } else {
        ++at;
      }
    }
    array.bytes.assign(file.begin() + static_cast<std::ptrdiff_t>(start + length), file.end());
    return array;
  }

  std::string path_;
  std::vector<char> data_;
  std::map<std::string, NpyArray> arrays_;
};

// A file of tests/golden. A golden that is missing throws, so the test fails.
inline Npz golden(const std::string& name) {
  return Npz(std::string(NOVAPHY_GOLDEN_DIR) + "/" + name);
}

}  // namespace novaphy::testing
