// OnHost: the rows of an array, readable on the host, with a copy if the array is on a device.
#pragma once

#include <span>
#include <vector>

#include "novaphy/core/device_array.h"

namespace novaphy {

// Provides the values of an array on the host: the array itself on the CPU, else a copy.
template <class T>
class OnHost {
 public:
  explicit OnHost(const DeviceArray<T>& array) {
    if (array.device().is_cpu()) {
      values_ = {array.data(), array.rows()};
    } else {
      copy_ = array.to_host();
      values_ = copy_;
    }
  }
  OnHost(const OnHost&) = delete;
  OnHost& operator=(const OnHost&) = delete;
  const T& operator[](size_t k) const { return values_[k]; }
  const T* data() const { return values_.data(); }
  size_t size() const { return values_.size(); }

 private:
  std::vector<T> copy_;
  std::span<const T> values_;
};

}  // namespace novaphy
