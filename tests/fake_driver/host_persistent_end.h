// Included after the text of a persistent kernel: runs the kernel. `start`: the words of a launch.
}  // namespace
}  // namespace device

extern "C" void run_persistent(const uint64_t* start, uint64_t* table, void* record, uint32_t* flag,
                               unsigned blocks, unsigned threads, unsigned seed) {
  gridDim.x = blocks;
  blockDim.x = threads;
  const device::persistent_start first{start[0], start[1], start[2], start[3]};
  device::device_sink sink{};
  sink.record = static_cast<device::device_error*>(record);
  sink.flag = flag;
#if PERSISTENT_EARLY != 0
  for (uint64_t job = 0; job < start[5]; ++job) {
    const auto* const words = reinterpret_cast<device::uint64_t*>(table);
    const auto* const of_job = words + start[4] + device::kJobWords * job;
    for (uint32_t slot = 0; slot < of_job[0] >> 32; ++slot)
      device::run_job(words, of_job, slot, sink);
  }
#endif
  g_thread = [&] {
    device::novaphy_main(first, reinterpret_cast<device::uint64_t*>(table), 0, sink);
  };
  run_all(seed);
}
