// Hand-written kernels on the CPU, without the tensor runtime.
#include <gtest/gtest.h>

#include <numeric>
#include <vector>

#include "novaphy/core/device_kernel.h"
#include "novaphy/core/parallel.h"
#include "support/bits.h"
#include "support/scale_kernels.h"

namespace novaphy::testing {
namespace {

const DeviceKernel kScale(test_scale, nullptr), kReverse(test_reverse, nullptr),
    kScan("exclusive_scan_i32");

DeviceArray<float> ramp(size_t rows) {
  std::vector<float> values(rows);
  std::iota(values.begin(), values.end(), 0.25f);
  return DeviceArray<float>::from_host(values);
}

TEST(DeviceKernel, RunsEveryRowOnceForAnyNumberOfThreads) {
  const int before = num_threads();
  for (const size_t rows : {1u, 255u, 256u, 257u, 5000u}) {
    const DeviceArray<float> x = ramp(rows);
    std::vector<float> expected = x.to_host();
    for (float& v : expected) v *= 1.5f;
    for (const int threads : {1, 2, 7}) {
      set_num_threads(threads);
      DeviceArray<float> y(rows), back(rows);
      kScale.launch(Device::cpu(), static_cast<int64_t>(rows),
                    {reads_row("x", x), writes_row("y", y), number(1.5f)});
      EXPECT_EQ(y.to_host(), expected) << rows << " rows, " << threads << " threads";
      kReverse.launch(Device::cpu(), static_cast<int64_t>(rows),
                      {reads("x", y), writes_row("y", back)});
      EXPECT_EQ(back.to_host(), std::vector<float>(expected.rbegin(), expected.rend()));
    }
  }
  set_num_threads(before);
}

TEST(DeviceKernel, RaisesTheVersionOfWhatItWritesOnly) {
  const DeviceArray<float> x = ramp(4);
  const DeviceArray<float> y(4);
  const uint64_t read = x.version(), written = y.version();
  kScale.launch(Device::cpu(), 4, {reads_row("x", x), writes_row("y", y), number(2.0f)});
  EXPECT_EQ(x.version(), read);
  EXPECT_GT(y.version(), written);
  const uint64_t now = y.version();
  kScale.launch(Device::cpu(), 0, {reads_row("x", x), writes_row("y", y), number(2.0f)});
  EXPECT_EQ(y.version(), now) << "no rows, nothing written";
}

TEST(DeviceKernel, LaunchesBuiltinsToo) {
  const auto in = DeviceArray<int32_t>::from_host(std::vector<int32_t>{3, 0, 2, 5});
  const DeviceArray<int32_t> out(4);
  kScan.launch(Device::cpu(), 4, {reads("in", in), writes("out", out)});
  EXPECT_EQ(out.to_host(), (std::vector<int32_t>{0, 3, 3, 5}));
}

TEST(DeviceKernel, NamesTheKernelAndTheArgumentOfAMistake) {
  const DeviceArray<float> x = ramp(3), y(4), none(0);
  EXPECT_ERROR(kScale.launch(Device::cpu(), 4, {reads_row("x", x), writes_row("y", y)}),
               ErrorKind::Value, "test_scale: expected 3 arguments, got 2");
  EXPECT_ERROR(
      kScale.launch(Device::cpu(), 4, {reads_row("x", x), writes_row("y", y), number(1.0f)}),
      ErrorKind::Value, "test_scale, x: expected at least 4 rows, got 3");
  EXPECT_ERROR(
      kScale.launch(Device::cpu(), 3, {reads_row("x", x), writes_row("y", none), number(1.0f)}),
      ErrorKind::Value, "test_scale, y: expected at least 3 rows, got");
}

// What the backend refuses.
TEST(DeviceKernel, AModuleOfARowFunctionIsChecked) {
  const DeviceContext& cpu = device_context(Device::cpu());
  const auto create = [&](const novaphy_row_function& function, uint64_t bytes) {
    novaphy_error error = make_error();
    novaphy_module* module = nullptr;
    const novaphy_status status =
        cpu.api->module_create(cpu.device, NOVAPHY_CODE_BINARY, &function, bytes, &module, &error);
    if (status != NOVAPHY_OK) return status;
    novaphy_kernel* kernel = nullptr;
    EXPECT_EQ(cpu.api->kernel_get(module, "main", &kernel, &error), NOVAPHY_INVALID_ARGUMENT);
    EXPECT_EQ(cpu.api->kernel_get(module, "test_scale", &kernel, &error), NOVAPHY_OK);
    const uint64_t words[2] = {};
    EXPECT_EQ(cpu.api->launch(cpu.stream, kernel, 1, words, 2, &error), NOVAPHY_INVALID_ARGUMENT);
    novaphy_kernel_info info{};
    info.struct_size = sizeof(info);
    EXPECT_EQ(cpu.api->kernel_info(kernel, &info, &error), NOVAPHY_OK);
    EXPECT_EQ(info.native, 1);
    EXPECT_EQ(info.hash, 0u);
    cpu.api->module_destroy(module);
    return status;
  };
  EXPECT_EQ(create(test_scale, sizeof(test_scale)), NOVAPHY_OK);
  EXPECT_EQ(create(test_scale, sizeof(test_scale) - 1), NOVAPHY_INVALID_ARGUMENT);
  novaphy_row_function wrong = test_scale;
  wrong.rows = nullptr;
  EXPECT_EQ(create(wrong, sizeof(wrong)), NOVAPHY_INVALID_ARGUMENT);
  wrong = test_scale;
  wrong.struct_size = 8;
  EXPECT_EQ(create(wrong, sizeof(wrong)), NOVAPHY_INVALID_ARGUMENT);
}

}  // namespace
}  // namespace novaphy::testing
