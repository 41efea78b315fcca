#include "harness.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <cstdio>
#include <cstring>
#include <memory>

namespace conformance {

Backend& backend() {
  static Backend instance;
  return instance;
}

uint32_t bits(float value) {
  uint32_t word;
  std::memcpy(&word, &value, 4);
  return word;
}
uint32_t bits(int32_t value) { return static_cast<uint32_t>(value); }

Buffer::Buffer(const std::vector<uint32_t>& words) : words_(words.size()) {
  const Backend& b = backend();
  novaphy_error error = make_error();
  EXPECT_EQ(
      b.api->memory_alloc(b.device, NOVAPHY_MEMORY_DEVICE, words.size() * 4, &pointer_, &error),
      NOVAPHY_OK)
      << error.message;
  EXPECT_EQ(b.api->memory_copy(b.stream, NOVAPHY_COPY_HOST_TO_DEVICE, pointer_, words.data(),
                               words.size() * 4, &error),
            NOVAPHY_OK)
      << error.message;
}

Buffer::~Buffer() { backend().api->memory_free(backend().device, NOVAPHY_MEMORY_DEVICE, pointer_); }

std::vector<uint32_t> Buffer::read() const {
  const Backend& b = backend();
  std::vector<uint32_t> words(words_);
  novaphy_error error = make_error();
  EXPECT_EQ(b.api->memory_copy(b.stream, NOVAPHY_COPY_DEVICE_TO_HOST, words.data(), pointer_,
                               words_ * 4, &error),
            NOVAPHY_OK)
      << error.message;
  EXPECT_EQ(b.api->stream_synchronize(b.stream, &error), NOVAPHY_OK) << error.message;
  return words;
}

Module::Module(const ir::Program& program) {
  const std::vector<uint32_t> words = ir::serialize(program);
  if (std::FILE* file = backend().collected) {
    EXPECT_EQ(std::fwrite(words.data(), 4, words.size(), file), words.size());
  }
  create(NOVAPHY_CODE_PROGRAM, words.data(), words.size() * 4);
  count_form();
}
Module::Module(const char* builtin) { create(NOVAPHY_CODE_BUILTIN, builtin, std::strlen(builtin)); }

void Module::create(int32_t format, const void* data, uint64_t bytes) {
  const Backend& b = backend();
  novaphy_error error = make_error();
  EXPECT_EQ(b.api->module_create(b.device, format, data, bytes, &module_, &error), NOVAPHY_OK)
      << error.message;
  if (module_ == nullptr) return;
  EXPECT_EQ(b.api->kernel_get(module_, "main", &kernel_, &error), NOVAPHY_OK) << error.message;
}

// The kind of code that the tests covered, if the backend reports it.
void Module::count_form() const {
  Backend& b = backend();
  constexpr size_t end = offsetof(novaphy_backend_api, kernel_info) + sizeof(b.api->kernel_info);
  if (kernel_ == nullptr || b.api->struct_size < end || b.api->kernel_info == nullptr) return;
  novaphy_kernel_info info{};
  info.struct_size = sizeof(info);
  novaphy_error error = make_error();
  EXPECT_EQ(b.api->kernel_info(kernel_, &info, &error), NOVAPHY_OK) << error.message;
  ++(info.native != 0 ? b.native : b.interpreted);
}

Module::~Module() {
  if (module_ != nullptr) backend().api->module_destroy(module_);
}

Result Module::launch(int64_t n, const std::vector<uint64_t>& arguments) const {
  const Backend& b = backend();
  Result result;
  if (kernel_ == nullptr) {
    result.status = NOVAPHY_INTERNAL;
    return result;
  }
  novaphy_error error = make_error();
  result.status = b.api->launch(b.stream, kernel_, n, arguments.data(),
                                static_cast<uint32_t>(arguments.size()), &error);
  // A device that runs behind reports a failing read when the stream is next waited for.
  if (result.status == NOVAPHY_OK) result.status = b.api->stream_synchronize(b.stream, &error);
  if (result.status != NOVAPHY_OK) result.message = error.message;
  return result;
}

Result run(const Module& module, const ir::Program& program, int64_t n, const Inputs& inputs) {
  std::vector<std::unique_ptr<Buffer>> buffers;
  std::vector<uint64_t> arguments;
  const auto add = [&](const std::vector<uint32_t>& words) {
    buffers.push_back(std::make_unique<Buffer>(words));
    arguments.push_back(buffers.back()->word());
  };
  for (size_t s = 0; s < program.sources.size(); ++s) {
    add(inputs.sources[s]);
    arguments.push_back(inputs.sources[s].size() / static_cast<size_t>(program.sources[s].width));
  }
  const size_t first_output = buffers.size();
  for (const ir::Output& output : program.outputs) {
    add(std::vector<uint32_t>(static_cast<size_t>(n) * output.values.size(), 0xDEADBEEFu));
  }
  size_t csr = 0;
  for (const ir::Loop& loop : program.loops) {
    if (loop.kind != ir::LoopKind::Csr) continue;
    add(inputs.offsets[csr]);
    if (inputs.null_items) {
      arguments.push_back(0);
    } else {
      add(inputs.items[csr]);
    }
    ++csr;
  }
  for (const uint32_t parameter : inputs.parameters) arguments.push_back(parameter);
  Result result = module.launch(n, arguments);
  for (size_t o = 0; o < program.outputs.size(); ++o)
    result.outputs.push_back(buffers[first_output + o]->read());
  return result;
}

Result run(const ir::Program& program, int64_t n, const Inputs& inputs) {
  return run(Module(program), program, n, inputs);
}

std::string difference(const ir::Program& program,
                       const std::vector<std::vector<uint32_t>>& expected,
                       const std::vector<std::vector<uint32_t>>& got) {
  for (size_t o = 0; o < expected.size(); ++o) {
    if (expected[o].size() != got[o].size())
      return "output " + std::to_string(o) + " has the wrong size";
    for (size_t k = 0; k < expected[o].size(); ++k) {
      const uint32_t e = expected[o][k], g = got[o][k];
      if (e == g) continue;
      float ef, gf;
      std::memcpy(&ef, &e, 4);
      std::memcpy(&gf, &g, 4);
      const bool is_float = program.outputs[o].type == ir::Type::F32;
      if (is_float && std::isnan(ef) && std::isnan(gf)) continue;
      char text[200];
      std::snprintf(text, sizeof(text),
                    "output %zu word %zu (row %zu): expected %08x (%g), got %08x (%g)", o, k,
                    k / program.outputs[o].values.size(), e, static_cast<double>(ef), g,
                    static_cast<double>(gf));
      return text;
    }
  }
  return {};
}

std::string check(const ir::Program& program, int64_t n, const Inputs& inputs) {
  const Result result = run(program, n, inputs);
  if (result.status != NOVAPHY_OK) return "launch failed: " + result.message;
  return difference(program, reference(program, n, inputs), result.outputs);
}

}  // namespace conformance
