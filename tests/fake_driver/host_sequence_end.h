// Behind the text of a sequence: runs it. `start`: the words of the first record, and where the
// tasks lie.
}  // namespace
}  // namespace device

extern "C" void run_sequence(const uint64_t* start, uint64_t* table, void* record, uint32_t* flag,
                             unsigned blocks, unsigned threads, unsigned seed) {
  gridDim.x = blocks;
  blockDim.x = threads;
  const device::sequence_start first{start[0], start[1], start[2]};
  device::device_sink sink{};
  sink.record = static_cast<device::device_error*>(record);
  sink.flag = flag;
#if SEQUENCE_AHEAD != 0
  for (uint64_t job = 0; job < start[4]; ++job) {
    const uint64_t* const words = table + start[3] + 2 * job;
    for (uint64_t row = 0; row < words[0] >> 32; ++row)
      device::run_ahead(static_cast<uint32_t>(words[0]),
                        reinterpret_cast<device::uint64_t*>(table) + words[1], row, sink);
  }
#endif
  g_thread = [&] {
    device::novaphy_main(first, reinterpret_cast<device::uint64_t*>(table), 0, sink);
  };
  run_all(seed);
}
