#include <gtest/gtest.h>

#include "novaphy/core/device.h"
#include "novaphy/core/error.h"
#include "novaphy/core/version.h"
#include "support/probe.h"

namespace novaphy {
namespace {

TEST(Device, ParsesEveryNameThatItPrints) {
  EXPECT_EQ(Device::parse("cpu"), Device::cpu());
  EXPECT_EQ(Device::parse("cpu:0"), Device::cpu());
  EXPECT_EQ(Device::parse("cuda"), Device::cuda(0));
  EXPECT_EQ(Device::parse("cuda:3"), Device::cuda(3));
  EXPECT_EQ(Device::parse("dlan:1"), (Device{DeviceType::DLAN, 1}));
  EXPECT_EQ(Device::cpu().str(), "cpu");
  EXPECT_EQ(Device::cuda(3).str(), "cuda:3");
  EXPECT_EQ(Device::parse(Device::cuda(12).str()), Device::cuda(12));
}

TEST(Device, RefusesEveryOtherName) {
  for (const char* spec : {"", "CPU", "gpu", "cuda:", "cuda:-1", "cuda:x", "cuda:1x", "cuda: 1",
                           "cuda:1:2", "cpu:1", "cuda:99999999999", "cuda:64", ":0", "cuda0"}) {
    try {
      Device::parse(spec);
      ADD_FAILURE() << spec;
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), ErrorKind::Value);
      EXPECT_NE(std::string(error.what()).find("got \"" + std::string(spec) + "\""),
                std::string::npos)
          << error.what();
    }
  }
}

TEST(Device, TheCpuIsAlwaysThereAndDescribed) {
  EXPECT_TRUE(device_available(Device::cpu()));
  EXPECT_NO_THROW(require_device(Device::cpu()));
  const DeviceInfo info = device_info(Device::cpu());
  EXPECT_FALSE(info.name.empty());
  EXPECT_TRUE(info.host_accessible);
  EXPECT_FALSE(info.supports_graph_capture);
  EXPECT_GE(info.units, 1);
  EXPECT_EQ(devices().front(), Device::cpu());
  EXPECT_NO_THROW(synchronize(Device::cpu()));
  EXPECT_FALSE(std::string(version()).empty());
}

TEST(Device, AnOrdinalThatDoesNotExistIsNotAvailable) {
  EXPECT_FALSE(device_available({DeviceType::CPU, 1}));
  EXPECT_FALSE(device_available({DeviceType::CPU, -1}));
  EXPECT_THROW(require_device({DeviceType::CPU, 1}), Error);
  EXPECT_THROW(require_device({DeviceType::CPU, -1}), Error);
  EXPECT_THROW(require_device({static_cast<DeviceType>(9), 0}), Error);
}

TEST(DefaultDevice, ComesFromTheEnvironment) {
  EXPECT_EQ(testing::probe("", "default_device").output, "cpu\n");
  EXPECT_EQ(testing::probe("NOVAPHY_DEVICE=cuda:2", "default_device").output, "cuda:2\n");
  const testing::Outcome bad = testing::probe("NOVAPHY_DEVICE=quantum", "default_device");
  EXPECT_EQ(bad.code, 1);
  EXPECT_NE(bad.output.find("NOVAPHY_DEVICE: device: expected"), std::string::npos) << bad.output;
}

TEST(DefaultDevice, CanBeSetOnlyToADeviceThatIsThere) {
  const Device before = default_device();
  EXPECT_NO_THROW(set_default_device(Device::cpu()));
  EXPECT_EQ(default_device(), Device::cpu());
  if (!device_available(Device::cuda(63))) {
    EXPECT_THROW(set_default_device(Device::cuda(63)), Error);
    EXPECT_EQ(default_device(), Device::cpu());
  }
  set_default_device(before);
}

}  // namespace
}  // namespace novaphy
