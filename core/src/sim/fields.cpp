#include "novaphy/core/sim/fields.h"

#include "novaphy/core/error.h"

namespace novaphy::detail {

void check_field(const FieldInfo& info, const Array& array, size_t expected_rows, Device device,
                 const char* what) {
  require(array.rows() == expected_rows && array.width() == info.width, ErrorKind::Value, what,
          ": ", info.name, ": expected ", expected_rows, " rows (", info.count_name, ") of width ",
          info.width, ", got ", array.rows(), " rows of width ", array.width());
  require(array.device() == device || array.rows() == 0, ErrorKind::Value, what, ": ", info.name,
          ": expected an array on ", device.str(), ", got one on ", array.device().str());
}

void assign_fields(const std::vector<MutableField>& targets, const std::vector<ConstField>& sources,
                   const char* what) {
  for (size_t i = 0; i < targets.size(); ++i) {
    const Array& target = *targets[i].array;
    const Array& source = *sources[i].array;
    require(source.rows() == target.rows() && source.width() == target.width(), ErrorKind::Value,
            what, ": ", targets[i].info.name, ": expected ", target.rows(), " rows, got ",
            source.rows());
    require(source.device() == target.device() || target.rows() == 0, ErrorKind::Value, what, ": ",
            targets[i].info.name, ": expected an array on ", target.device().str(), ", got one on ",
            source.device().str());
  }
  for (size_t i = 0; i < targets.size(); ++i) targets[i].array->assign(*sources[i].array);
}

}  // namespace novaphy::detail
