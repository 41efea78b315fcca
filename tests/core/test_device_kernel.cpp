// Handwritten kernels on the CPU, without the tensor runtime.
#include <gtest/gtest.h>

#include <algorithm>
#include <numeric>
#include <vector>

#include "novaphy/core/device_kernel.h"
#include "novaphy/core/launch_list.h"
#include "novaphy/core/parallel.h"
#include "support/bits.h"
#include "support/scale_kernels.h"

namespace novaphy::testing {
namespace {

const Kernel<ScaleArguments> kScale(test_scale, nullptr);
const Kernel<ReverseArguments> kReverse(test_reverse, nullptr);
const DeviceKernel kScan("exclusive_scan_i32");

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
      run(kScale, static_cast<int64_t>(rows), {.x = x, .y = y, .factor = 1.5f});
      EXPECT_EQ(y.to_host(), expected) << rows << " rows, " << threads << " threads";
      run(kReverse, static_cast<int64_t>(rows), {.x = y, .y = back});
      EXPECT_EQ(back.to_host(), std::vector<float>(expected.rbegin(), expected.rend()));
    }
  }
  set_num_threads(before);
}

TEST(DeviceKernel, RaisesTheVersionOfWhatItWritesOnly) {
  const DeviceArray<float> x = ramp(4);
  const DeviceArray<float> y(4);
  const uint64_t read = x.version(), written = y.version();
  run(kScale, 4, {.x = x, .y = y, .factor = 2.0f});
  EXPECT_EQ(x.version(), read);
  EXPECT_GT(y.version(), written);
  const uint64_t now = y.version();
  run(kScale, 0, {.x = x, .y = y, .factor = 2.0f});
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
  const auto scale = [](int64_t n, const DeviceArray<float>& from, const DeviceArray<float>& to) {
    run(kScale, n, {.x = from, .y = to, .factor = 1.0f});
  };
  EXPECT_ERROR(scale(4, x, y), ErrorKind::Value, "test_scale, x: expected at least 4 rows, got 3");
  EXPECT_ERROR(scale(3, x, none), ErrorKind::Value, "test_scale, y: expected at least 3 rows, got");
}

TEST(LaunchList, RunsItsLaunchesInOrderForAnyNumberOfThreads) {
  const int before = num_threads();
  for (const size_t rows : {1u, 300u, 5000u}) {
    const DeviceArray<float> x = ramp(rows), y(rows), back(rows);
    const auto n = static_cast<int64_t>(rows);
    std::vector<float> expected = x.to_host();
    for (float& v : expected) v *= 1.5f;
    std::reverse(expected.begin(), expected.end());
    LaunchList list(Device::cpu());
    list.add(kScale, n, {.x = x, .y = y, .factor = 1.5f});
    list.add(kReverse, n, {.x = y, .y = back}, 64);
    for (const int threads : {1, 2, 7}) {
      set_num_threads(threads);
      DeviceArray<float>(back).zero();
      const uint64_t version = back.version();
      list.run();
      EXPECT_EQ(back.to_host(), expected) << rows << " rows, " << threads << " threads";
      EXPECT_GT(back.version(), version);
    }
  }
  set_num_threads(before);
}

TEST(LaunchList, AStretchRunsAloneAndWhatIsSetDiffers) {
  const DeviceArray<float> x = ramp(3), y(3), z(3), other(2);
  LaunchList list(Device::cpu());
  const auto first = list.add(kScale, 3, {.x = x, .y = y, .factor = 2.0f});
  list.add(kScale, 0, {.x = x, .y = z, .factor = 9.0f});  // no rows: no phase
  list.add(kScale, 3, {.x = y, .y = z, .factor = 4.0f});
  list.run(0, 1);
  EXPECT_EQ(y.to_host(), (std::vector<float>{0.5f, 2.5f, 4.5f}));
  EXPECT_EQ(z.to_host(), (std::vector<float>{0.0f, 0.0f, 0.0f}));
  const uint64_t version = y.version();
  list.run(1, 3);
  EXPECT_EQ(z.to_host(), (std::vector<float>{2.0f, 10.0f, 18.0f}));
  EXPECT_EQ(y.version(), version);
  list.set(first, {.x = z, .y = y, .factor = -1.0f});
  list.run();
  EXPECT_EQ(z.to_host(), (std::vector<float>{-8.0f, -40.0f, -72.0f}));
  const auto set_other = [&] { list.set(first, {.x = other, .y = y, .factor = 1.0f}); };
  EXPECT_ERROR(set_other(), ErrorKind::Value, "test_scale, x: expected at least 3 rows, got 2");
}

TEST(LaunchList, TakesMemoryOnTheCpuAsALaunchByItself) {
  const std::vector<float> x = {1.0f, 2.0f};
  std::vector<float> y(2);
  LaunchList list(Device::cpu());
  list.add(kScale, 2, {.x = direct(x), .y = direct(y), .factor = 3.0f});
  list.run();
  EXPECT_EQ(y, (std::vector<float>{3.0f, 6.0f}));
  const DeviceArray<float> z(2);
  run(kScale, 2, {.x = direct(x), .y = z, .factor = 4.0f});
  EXPECT_EQ(z.to_host(), (std::vector<float>{4.0f, 8.0f}));
}

// The arguments that the backend refuses.
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
