#include <gtest/gtest.h>

#include <string>
#include <vector>

#include "novaphy/core/device_array.h"

namespace novaphy {
namespace {

template <class F>
std::string message_of(ErrorKind kind, F&& f) {
  try {
    f();
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), kind) << error.what();
    return error.what();
  }
  ADD_FAILURE() << "nothing was thrown";
  return {};
}

// Records the reported reads and writes.
class Recorder : public ArrayObserver {
 public:
  Recorder() : before_(set_array_observer(this)) {}
  ~Recorder() override { set_array_observer(before_); }
  void host_read(const char* what) override { log.push_back(std::string("read ") + what); }
  void untracked_write(Range&, const char* what) override {
    log.push_back(std::string("write ") + what);
  }
  bool copy(const std::shared_ptr<Range>&, const std::shared_ptr<Range>&, bool is_float) override {
    log.push_back(std::string("copy ") + (is_float ? "float" : "other"));
    return takes_copies;
  }
  void untracked_operation(const char* what) override {
    log.push_back(std::string("operation ") + what);
  }

  std::vector<std::string> log;
  bool takes_copies = false;

 private:
  ArrayObserver* before_;
};

using Log = std::vector<std::string>;

TEST(DeviceArray, RoundTripsValuesAndStartsAtZero) {
  const DeviceArray<Vec3f> zero(4, Device::cpu());
  EXPECT_EQ(zero.to_host(), std::vector<Vec3f>(4));
  const std::vector<Vec3f> values = {{1, 2, 3}, {4, 5, 6}};
  const auto array = DeviceArray<Vec3f>::from_host(values, Device::cpu());
  EXPECT_EQ(array.to_host(), values);
  EXPECT_EQ(array.rows(), 2u);
  EXPECT_EQ(array.bytes(), 24u);
  EXPECT_EQ(array.shape(), (std::vector<int64_t>{2, 3}));
  EXPECT_EQ(array.device(), Device::cpu());
}

TEST(DeviceArray, KnowsEveryElementType) {
  EXPECT_EQ(DeviceArray<Transformf>(2).shape(), (std::vector<int64_t>{2, 7}));
  EXPECT_EQ(DeviceArray<SpatialVectorf>(2).shape(), (std::vector<int64_t>{2, 6}));
  EXPECT_EQ(DeviceArray<Mat33f>(2).shape(), (std::vector<int64_t>{2, 3, 3}));
  EXPECT_EQ(DeviceArray<Mat22f>(1).shape(), (std::vector<int64_t>{1, 2, 2}));
  EXPECT_EQ(DeviceArray<uint8_t>(5).bytes(), 5u);
  EXPECT_EQ(DeviceArray<uint64_t>(5).bytes(), 40u);
  EXPECT_EQ(DeviceArray<float>(5, Device::cpu(), 3).shape(), (std::vector<int64_t>{5, 3}));
  for (int k = 0; k <= static_cast<int>(DType::vec4i); ++k) {
    const DTypeInfo& info = dtype_info(static_cast<DType>(k));
    EXPECT_EQ(info.bytes, static_cast<size_t>(info.scalars) * scalar_bytes(info.scalar))
        << info.name;
    EXPECT_EQ(info.scalars, info.shape[0] * info.shape[1]) << info.name;
  }
}

TEST(DeviceArray, AnEmptyHandleBehavesLikeZeroRows) {
  DeviceArray<float> array;
  EXPECT_EQ(array.rows(), 0u);
  EXPECT_EQ(array.data(), nullptr);
  EXPECT_EQ(array.mutable_data(), nullptr);
  EXPECT_TRUE(array.to_host().empty());
  EXPECT_NO_THROW(array.zero());
  EXPECT_NO_THROW(array.fill(1.0f));
  EXPECT_NO_THROW(array.assign(DeviceArray<float>(0)));
  EXPECT_EQ(array.clone().rows(), 0u);
  EXPECT_EQ(array.version(), 0u);
}

TEST(DeviceArray, CopiesOfTheHandleShareMemoryAndClonesDoNot) {
  auto a = DeviceArray<float>::from_host(std::vector<float>{1, 2}, Device::cpu());
  const DeviceArray<float> b = a;
  const DeviceArray<float> c = a.clone();
  a.mutable_data()[0] = 9.0f;
  EXPECT_EQ(b.to_host()[0], 9.0f);
  EXPECT_EQ(c.to_host()[0], 1.0f);
  EXPECT_EQ(a.range(), b.range());
}

TEST(DeviceArray, EveryWriteRaisesTheVersionAndNoReadDoes) {
  DeviceArray<float> a(3, Device::cpu());
  EXPECT_EQ(a.version(), 0u);
  a.copy_from_host(std::vector<float>{1, 2, 3});
  EXPECT_EQ(a.version(), 1u);
  a.zero();
  EXPECT_EQ(a.version(), 2u);
  a.fill(4.0f);
  EXPECT_EQ(a.version(), 3u);
  a.mutable_data();
  EXPECT_EQ(a.version(), 4u);
  a.assign(DeviceArray<float>(3, Device::cpu()));
  EXPECT_EQ(a.version(), 5u);
  a.to_host();
  a.data();
  a.clone();
  a.assign(a);
  EXPECT_EQ(a.version(), 5u);
}

TEST(DeviceArray, FillsElementsOfEverySize) {
  DeviceArray<Vec3f> vectors(5, Device::cpu());
  vectors.fill({1, 2, 3});
  EXPECT_EQ(vectors.to_host(), std::vector<Vec3f>(5, Vec3f{1, 2, 3}));
  DeviceArray<uint8_t> bytes(7, Device::cpu());
  bytes.fill(250);
  EXPECT_EQ(bytes.to_host(), std::vector<uint8_t>(7, 250));
  DeviceArray<uint64_t> words(3, Device::cpu());
  words.fill(0x123456789ABCDEFull);
  EXPECT_EQ(words.to_host(), std::vector<uint64_t>(3, 0x123456789ABCDEFull));
  DeviceArray<float> table(3, Device::cpu(), 4);
  table.fill(0.5f);
  EXPECT_EQ(table.to_host(), std::vector<float>(12, 0.5f));
  EXPECT_NE(message_of(ErrorKind::Value, [&] { words.fill_bytes("abc", 3); })
                .find("expected an element of 8 bytes, got 3"),
            std::string::npos);
}

TEST(DeviceArray, SaysWhatSizeItExpectedAndGot) {
  DeviceArray<Vec3f> a(2, Device::cpu());
  const std::string from =
      message_of(ErrorKind::Value, [&] { a.copy_from_host(std::vector<Vec3f>(3)); });
  EXPECT_NE(from.find("copy_from_host: expected 24 bytes for vec3[2], got 36"), std::string::npos)
      << from;
  std::vector<Vec3f> small(1);
  const std::string to =
      message_of(ErrorKind::Value, [&] { a.copy_to_host(std::span<Vec3f>(small)); });
  EXPECT_NE(to.find("copy_to_host: expected 24 bytes for vec3[2], got 12"), std::string::npos)
      << to;
  const std::string assigned =
      message_of(ErrorKind::Value, [&] { a.assign(DeviceArray<Vec3f>(3, Device::cpu())); });
  EXPECT_NE(assigned.find("assign: expected vec3[2], got vec3[3]"), std::string::npos) << assigned;
  message_of(ErrorKind::Value, [&] { a.assign(DeviceArray<float>(2, Device::cpu(), 3)); });
  message_of(ErrorKind::Value, [] { DeviceArray<Vec3f>(2, Device::cpu(), 3); });
  message_of(ErrorKind::Value, [] { DeviceArray<float>(2, Device::cpu(), 0); });
  message_of(ErrorKind::Value, [] { DeviceArray<float>(~size_t{0} / 4, Device::cpu(), 2); });
  message_of(ErrorKind::Type, [&] { DeviceArray<float>(static_cast<Array>(a)); });
}

TEST(DeviceArray, ViewsAPartOfAStorage) {
  const auto storage = Storage::allocate(1024, Device::cpu());
  Array left(DType::vec3, 4, 1, storage->range(0, 48));
  Array right(DType::float32, 4, 3, storage->range(48, 48));
  Array both(DType::float32, 24, 1, storage->range(0, 96));
  right.zero();
  EXPECT_EQ(left.version(), 0u);
  EXPECT_EQ(both.version(), 1u);
  message_of(ErrorKind::Value, [&] { Array(DType::vec3, 4, 1, storage->range(0, 44)); });
  message_of(ErrorKind::Value, [&] { Array(DType::vec3, 4, 1, nullptr); });
  Array shifted(DType::float32, 12, 1, storage->range(4, 48));
  Array start(DType::float32, 12, 1, storage->range(0, 48));
  EXPECT_NE(message_of(ErrorKind::Value, [&] { start.assign(shifted); }).find("overlaps"),
            std::string::npos);
}

TEST(DeviceArray, TheObserverHearsOfHostReadsUntrackedWritesAndCopies) {
  auto a = DeviceArray<float>::from_host(std::vector<float>{1, 2}, Device::cpu());
  DeviceArray<float> b(2, Device::cpu());
  DeviceArray<int32_t> i(2, Device::cpu());
  Recorder recorder;
  a.to_host();
  a.copy_from_host(std::vector<float>{3, 4});
  a.zero();
  a.fill(5.0f);
  a.mutable_data();
  EXPECT_EQ(recorder.log, (Log{"read copy_to_host", "write copy_from_host", "write zero",
                               "write fill", "write mutable data"}));
  recorder.log.clear();
  b.assign(a);
  i.assign(DeviceArray<int32_t>(2, Device::cpu()));
  a.clone();
  a.data();
  EXPECT_EQ(recorder.log, (Log{"copy float", "copy other", "copy float"}));
  EXPECT_EQ(b.version(), 1u) << "nobody took the copy, so the array made it";
}

TEST(DeviceArray, AnObserverMayTakeTheCopyOver) {
  const auto a = DeviceArray<float>::from_host(std::vector<float>{1, 2}, Device::cpu());
  DeviceArray<float> b(2, Device::cpu());
  {
    Recorder recorder;
    recorder.takes_copies = true;
    b.assign(a);
  }
  EXPECT_EQ(b.version(), 0u);
  EXPECT_EQ(b.to_host(), std::vector<float>(2, 0.0f));
  EXPECT_EQ(array_observer(), nullptr);
}

}  // namespace
}  // namespace novaphy
