// Devices, memory, streams, events and modules.
#include <gtest/gtest.h>

#include <cstring>
#include <limits>

#include "harness.h"

namespace conformance {
namespace {

using ir::Op;
using ir::Type;

class Conformance : public testing::Test {
 protected:
  const novaphy_backend_api* api = backend().api;
  novaphy_device* device = backend().device;
  novaphy_stream* stream = backend().stream;
  novaphy_error error = make_error();

  void* alloc(uint64_t bytes) {
    void* pointer = nullptr;
    EXPECT_EQ(api->memory_alloc(device, NOVAPHY_MEMORY_DEVICE, bytes, &pointer, &error), NOVAPHY_OK)
        << error.message;
    return pointer;
  }
};

TEST_F(Conformance, TheTableHasANameAVersionAndTheMajorVersionOfTheHost) {
  EXPECT_GE(api->struct_size, sizeof(novaphy_backend_api));
  EXPECT_EQ(api->abi_major, NOVAPHY_ABI_MAJOR);
  EXPECT_NE(api->name, nullptr);
  EXPECT_NE(api->version, nullptr);
}

TEST_F(Conformance, TheCaptureGroupIsWholeOrAbsentAsTheCapabilitySays) {
  novaphy_device_info info{};
  info.struct_size = sizeof(info);
  ASSERT_EQ(api->device_info(0, &info, &error), NOVAPHY_OK);
  const bool says = (info.capabilities & NOVAPHY_CAP_GRAPH_CAPTURE) != 0;
  EXPECT_EQ(api->capture_begin != nullptr, says);
  EXPECT_EQ(api->capture_end != nullptr, says);
  EXPECT_EQ(api->graph_launch != nullptr, says);
  EXPECT_EQ(api->graph_destroy != nullptr, says);
}

TEST_F(Conformance, EveryDeviceDescribesItself) {
  for (int32_t ordinal = 0; ordinal < backend().device_total; ++ordinal) {
    novaphy_device_info info{};
    info.struct_size = sizeof(info);
    ASSERT_EQ(api->device_info(ordinal, &info, &error), NOVAPHY_OK) << error.message;
    EXPECT_NE(info.name[0], '\0');
    EXPECT_GE(info.units, 1);
    EXPECT_GT(info.total_memory, 0u);
    EXPECT_LE(info.free_memory, info.total_memory);
  }
}

TEST_F(Conformance, ADeviceThatIsNotThereIsRefusedWithAMessage) {
  novaphy_device_info info{};
  info.struct_size = sizeof(info);
  for (const int32_t ordinal : {-1, backend().device_total}) {
    novaphy_device* none = nullptr;
    error = make_error();
    EXPECT_NE(api->device_info(ordinal, &info, &error), NOVAPHY_OK);
    EXPECT_NE(error.message[0], '\0');
    error = make_error();
    EXPECT_NE(api->device_open(ordinal, &none, &error), NOVAPHY_OK);
    EXPECT_NE(error.message[0], '\0');
  }
}

TEST_F(Conformance, MemoryIsAlignedAndZeroBytesAreLegal) {
  for (const int32_t kind : {NOVAPHY_MEMORY_DEVICE, NOVAPHY_MEMORY_PINNED_HOST}) {
    for (const uint64_t bytes : {0, 1, 255, 256, 257, 100000}) {
      void* pointer = nullptr;
      ASSERT_EQ(api->memory_alloc(device, kind, bytes, &pointer, &error), NOVAPHY_OK)
          << error.message;
      EXPECT_EQ(reinterpret_cast<uintptr_t>(pointer) % 256, 0u);
      api->memory_free(device, kind, pointer);
    }
  }
  EXPECT_EQ(api->memory_copy(stream, NOVAPHY_COPY_HOST_TO_DEVICE, nullptr, nullptr, 0, &error),
            NOVAPHY_OK);
  EXPECT_EQ(api->memory_fill(stream, nullptr, 0, 4, 0, &error), NOVAPHY_OK);
}

TEST_F(Conformance, AnAllocationThatCannotFitIsOutOfMemory) {
  void* pointer = nullptr;
  for (const uint64_t bytes : {uint64_t{1} << 62, std::numeric_limits<uint64_t>::max()}) {
    error = make_error();
    EXPECT_EQ(api->memory_alloc(device, NOVAPHY_MEMORY_DEVICE, bytes, &pointer, &error),
              NOVAPHY_OUT_OF_MEMORY);
    EXPECT_NE(error.message[0], '\0');
  }
}

TEST_F(Conformance, BytesComeBackAfterCopiesThereAcrossAndBack) {
  std::vector<unsigned char> in(10007), out(in.size());
  for (size_t k = 0; k < in.size(); ++k) in[k] = static_cast<unsigned char>(k * 31 + 7);
  void* a = alloc(in.size());
  void* b = alloc(in.size());
  EXPECT_EQ(api->memory_copy(stream, NOVAPHY_COPY_HOST_TO_DEVICE, a, in.data(), in.size(), &error),
            NOVAPHY_OK);
  EXPECT_EQ(api->memory_copy(stream, NOVAPHY_COPY_DEVICE_TO_DEVICE, b, a, in.size(), &error),
            NOVAPHY_OK);
  EXPECT_EQ(api->memory_copy(stream, NOVAPHY_COPY_DEVICE_TO_HOST, out.data(), b, in.size(), &error),
            NOVAPHY_OK);
  EXPECT_EQ(api->stream_synchronize(stream, &error), NOVAPHY_OK);
  EXPECT_EQ(in, out);
  api->memory_free(device, NOVAPHY_MEMORY_DEVICE, a);
  api->memory_free(device, NOVAPHY_MEMORY_DEVICE, b);
}

TEST_F(Conformance, FillRepeatsPatternsOfOneTwoFourAndEightBytes) {
  const uint64_t pattern = 0x8877665544332211ull;
  for (const uint32_t size : {1u, 2u, 4u, 8u}) {
    for (const uint64_t count : {0, 1, 3, 1000}) {
      const uint64_t bytes = count * size;
      std::vector<unsigned char> out(bytes + 8, 0xEE);
      void* memory = alloc(out.size());
      ASSERT_EQ(api->memory_copy(stream, NOVAPHY_COPY_HOST_TO_DEVICE, memory, out.data(),
                                 out.size(), &error),
                NOVAPHY_OK);
      ASSERT_EQ(api->memory_fill(stream, memory, pattern, size, bytes, &error), NOVAPHY_OK)
          << error.message;
      ASSERT_EQ(api->memory_copy(stream, NOVAPHY_COPY_DEVICE_TO_HOST, out.data(), memory,
                                 out.size(), &error),
                NOVAPHY_OK);
      ASSERT_EQ(api->stream_synchronize(stream, &error), NOVAPHY_OK);
      for (uint64_t k = 0; k < bytes; ++k)
        ASSERT_EQ(out[k], (pattern >> (8 * (k % size))) & 0xFF) << size << " " << k;
      for (uint64_t k = bytes; k < out.size(); ++k)
        ASSERT_EQ(out[k], 0xEE) << "written past the end";
      api->memory_free(device, NOVAPHY_MEMORY_DEVICE, memory);
    }
  }
  void* memory = alloc(64);
  EXPECT_EQ(api->memory_fill(stream, memory, 0, 3, 6, &error), NOVAPHY_INVALID_ARGUMENT);
  EXPECT_EQ(api->memory_fill(stream, memory, 0, 4, 6, &error), NOVAPHY_INVALID_ARGUMENT);
  api->memory_free(device, NOVAPHY_MEMORY_DEVICE, memory);
}

TEST_F(Conformance, EventsOrderStreamsAndMeasureTime) {
  novaphy_stream* second = nullptr;
  novaphy_event *start = nullptr, *stop = nullptr;
  ASSERT_EQ(api->stream_create(device, &second, &error), NOVAPHY_OK);
  ASSERT_EQ(api->event_create(device, &start, &error), NOVAPHY_OK);
  ASSERT_EQ(api->event_create(device, &stop, &error), NOVAPHY_OK);
  void* memory = alloc(1 << 20);
  EXPECT_EQ(api->event_record(start, stream, &error), NOVAPHY_OK);
  EXPECT_EQ(api->memory_fill(stream, memory, 7, 1, 1 << 20, &error), NOVAPHY_OK);
  EXPECT_EQ(api->event_record(stop, stream, &error), NOVAPHY_OK);
  EXPECT_EQ(api->stream_wait(second, stop, &error), NOVAPHY_OK);
  unsigned char byte = 0;
  EXPECT_EQ(api->memory_copy(second, NOVAPHY_COPY_DEVICE_TO_HOST, &byte, memory, 1, &error),
            NOVAPHY_OK);
  EXPECT_EQ(api->stream_synchronize(second, &error), NOVAPHY_OK);
  EXPECT_EQ(byte, 7);
  EXPECT_EQ(api->event_synchronize(stop, &error), NOVAPHY_OK);
  double seconds = -1.0;
  EXPECT_EQ(api->event_elapsed(start, stop, &seconds, &error), NOVAPHY_OK) << error.message;
  EXPECT_GE(seconds, 0.0);
  EXPECT_LT(seconds, 60.0);
  api->memory_free(device, NOVAPHY_MEMORY_DEVICE, memory);
  api->event_destroy(start);
  api->event_destroy(stop);
  api->stream_destroy(second);
}

ir::Program small_program() {
  Builder b;
  const int32_t source = b.source(Type::F32, 3);
  b.p.param_count = 1;
  const ir::Value x = b.load(source, b.index(), 1);
  b.output({b.op(Op::MUL, x, b.op(Op::PARAM_F, 0))});
  return b.p;
}

TEST_F(Conformance, ModulesRefuseWhatIsNoProgramWithAMessage) {
  const std::vector<uint32_t> good = ir::serialize(small_program());
  const auto refused = [&](const std::vector<uint32_t>& words, uint64_t bytes, const char* what) {
    novaphy_module* module = nullptr;
    error = make_error();
    EXPECT_EQ(
        api->module_create(device, NOVAPHY_CODE_PROGRAM, words.data(), bytes, &module, &error),
        NOVAPHY_INVALID_ARGUMENT)
        << what;
    EXPECT_EQ(module, nullptr) << what;
    EXPECT_NE(error.message[0], '\0') << what;
  };
  refused({}, 0, "nothing");
  refused({1, 2, 3}, 12, "too short");
  refused(std::vector<uint32_t>(100, 0xABCDEF01u), 400, "garbage");
  refused(good, good.size() * 4 - 1, "no whole words");
  auto bad = good;
  bad[NOVAPHY_PROGRAM_HEADER_MAGIC] ^= 1;
  refused(bad, bad.size() * 4, "magic");
  bad = good;
  bad[NOVAPHY_PROGRAM_HEADER_VERSION] += 1;
  refused(bad, bad.size() * 4, "version");
  for (size_t length = 0; length < good.size(); ++length) refused(good, length * 4, "truncated");
}

// One word is changed at a time. The backend may accept or refuse it, but never crash. Most of the
// Programs also run.
TEST_F(Conformance, AProgramWithAnyOneWordChangedIsAcceptedOrRefused) {
  const std::vector<uint32_t> good = ir::serialize(small_program());
  for (size_t at = 0; at < good.size(); ++at) {
    for (const uint32_t value : {0u, 1u, 0xFFFFFFFFu, 0x7FFFFFFFu, 1000u}) {
      auto words = good;
      words[at] = value;
      novaphy_module* module = nullptr;
      error = make_error();
      const novaphy_status status = api->module_create(device, NOVAPHY_CODE_PROGRAM, words.data(),
                                                       words.size() * 4, &module, &error);
      if (status == NOVAPHY_OK) {
        ASSERT_NE(module, nullptr);
        api->module_destroy(module);
      } else {
        EXPECT_EQ(module, nullptr);
        EXPECT_NE(error.message[0], '\0');
      }
    }
  }
}

TEST_F(Conformance, UnknownFormatsAndKernelNamesAreRefused) {
  novaphy_module* module = nullptr;
  EXPECT_NE(api->module_create(device, 99, "x", 1, &module, &error), NOVAPHY_OK);
  EXPECT_EQ(module, nullptr);
  const auto words = ir::serialize(small_program());
  ASSERT_EQ(api->module_create(device, NOVAPHY_CODE_PROGRAM, words.data(), words.size() * 4,
                               &module, &error),
            NOVAPHY_OK);
  novaphy_kernel* kernel = nullptr;
  EXPECT_EQ(api->kernel_get(module, "other", &kernel, &error), NOVAPHY_INVALID_ARGUMENT);
  EXPECT_EQ(kernel, nullptr);
  api->module_destroy(module);
}

TEST_F(Conformance, ALaunchOverNothingDoesNothingAndAWrongArgumentCountIsRefused) {
  const Module module(small_program());
  EXPECT_EQ(module.launch(0, {0, 0, 0, 0}).status, NOVAPHY_OK);
  for (const size_t count : {0u, 3u, 5u}) {
    const Result result = module.launch(1, std::vector<uint64_t>(count, 0));
    EXPECT_EQ(result.status, NOVAPHY_INVALID_ARGUMENT);
    EXPECT_FALSE(result.message.empty());
  }
  EXPECT_EQ(module.launch(-1, {0, 0, 0, 0}).status, NOVAPHY_INVALID_ARGUMENT);
}

TEST_F(Conformance, AProgramMayBeAtAnyAddress) {
  const auto words = ir::serialize(small_program());
  std::vector<unsigned char> bytes(words.size() * 4 + 1);
  std::memcpy(bytes.data() + 1, words.data(), words.size() * 4);
  novaphy_module* module = nullptr;
  ASSERT_EQ(api->module_create(device, NOVAPHY_CODE_PROGRAM, bytes.data() + 1, words.size() * 4,
                               &module, &error),
            NOVAPHY_OK)
      << error.message;
  api->module_destroy(module);
}

}  // namespace
}  // namespace conformance
