//===- Builder.cpp - Building the IR of a kernel --------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// One builder makes one module with one `tai.kernel`. The front end in Python
// drives it; the builder keeps the insertion point, the current location, and
// interned types and attributes.
//
// Bodies are built in detached regions, because the result types of an `scf.if`
// are known only after its branches are built.
//
//===----------------------------------------------------------------------===//

#include "Core.h"

#include "mlir-c/BuiltinAttributes.h"
#include "mlir-c/BuiltinTypes.h"

#include <unordered_map>
#include <vector>

using namespace taipy;

namespace {

struct Type {
  MlirType handle;
};
struct Attribute {
  MlirAttribute handle;
};
struct Value {
  MlirValue handle;
};
struct Block {
  MlirBlock handle;
};
/// A region until it is given to an op; null afterwards.
struct Region {
  MlirRegion handle;
};
using RegionRef = std::shared_ptr<Region>;

MlirStringRef toRef(const std::string &text) {
  return mlirStringRefCreate(text.data(), text.size());
}

void appendText(MlirStringRef piece, void *text) {
  static_cast<std::string *>(text)->append(piece.data, piece.length);
}

class Builder {
public:
  Builder(ContextRef contextRef, const std::string &file)
      : context(std::move(contextRef)),
        mlir(taiContextGetMlirContext(context->handle)), file(file) {
    setLocation(1, 1);
    module = mlirModuleCreateEmpty(location);
  }
  ~Builder() {
    dropRegions();
    if (module.ptr)
      mlirModuleDestroy(module);
  }
  Builder(const Builder &) = delete;
  Builder &operator=(const Builder &) = delete;

  void setFile(const std::string &name) { file = name; }
  void setLocation(unsigned line, unsigned column) {
    location = mlirLocationFileLineColGet(mlir, toRef(file), line, column);
  }

  Type type(const std::string &text) {
    auto [entry, isNew] = types.try_emplace(text);
    if (isNew)
      entry->second = mlirTypeParseGet(mlir, toRef(text));
    if (mlirTypeIsNull(entry->second))
      throw py::value_error("not a type: " + text);
    return {entry->second};
  }

  Attribute attribute(const std::string &text) {
    auto [entry, isNew] = attributes.try_emplace(text);
    if (isNew)
      entry->second = mlirAttributeParseGet(mlir, toRef(text));
    if (mlirAttributeIsNull(entry->second))
      throw py::value_error("not an attribute: " + text);
    return {entry->second};
  }

  Attribute stringAttribute(const std::string &text) {
    return {mlirStringAttrGet(mlir, toRef(text))};
  }

  /// A constant of a scalar type, or with the same number in all components.
  Attribute number(Type type, const py::object &value) {
    MlirType scalar = type.handle;
    if (mlirTypeIsAVector(scalar))
      scalar = mlirShapedTypeGetElementType(scalar);
    MlirAttribute result;
    if (mlirTypeIsAFloat(scalar)) {
      result = mlirFloatAttrDoubleGet(mlir, scalar, value.cast<double>());
    } else {
      auto bits =
          static_cast<int64_t>(PyLong_AsUnsignedLongLongMask(value.ptr()));
      if (PyErr_Occurred())
        throw py::error_already_set();
      result = mlirIntegerAttrGet(scalar, bits);
    }
    if (mlirTypeIsAVector(type.handle))
      result = mlirDenseElementsAttrSplatGet(type.handle, result);
    return {result};
  }

  RegionRef region() {
    regions.push_back(std::make_shared<Region>(Region{mlirRegionCreate()}));
    return regions.back();
  }

  /// Makes a block with arguments; the last arguments get the given names, for
  /// remarks.
  Block block(const RegionRef &region, const std::vector<Type> &arguments,
              const std::vector<std::string> &names) {
    std::vector<MlirType> argumentTypes;
    argumentTypes.reserve(arguments.size());
    for (Type argument : arguments)
      argumentTypes.push_back(argument.handle);
    std::vector<MlirLocation> locations(arguments.size(), location);
    for (size_t i = 0; i != std::min(names.size(), locations.size()); ++i)
      locations[locations.size() - names.size() + i] = mlirLocationNameGet(
          mlir, mlirStringRefCreate(names[i].data(), names[i].size()),
          location);
    MlirBlock block = mlirBlockCreate(static_cast<intptr_t>(arguments.size()),
                                      argumentTypes.data(), locations.data());
    mlirRegionAppendOwnedBlock(region->handle, block);
    return {block};
  }

  void setBlock(Block block) { current = block.handle; }
  Block getBlock() const { return {current}; }

  py::object op(const std::string &name, const py::sequence &operands,
                const py::sequence &resultTypes, const py::object &attrs,
                const py::object &ownedRegions) {
    MlirOperation made =
        create(name, operands, resultTypes, attrs, ownedRegions);
    mlirBlockAppendOwnedOperation(current, made);
    return results(made);
  }

  /// Makes an `arith.constant` at the start of `block`, so that it dominates
  /// all ops there.
  Value constant(Block block, Type type, const py::object &value) {
    MlirOperationState state =
        mlirOperationStateGet(toRef(constantName), location);
    mlirOperationStateAddResults(&state, 1, &type.handle);
    MlirNamedAttribute named = mlirNamedAttributeGet(
        mlirIdentifierGet(mlir, mlirStringRefCreateFromCString("value")),
        number(type, value).handle);
    mlirOperationStateAddAttributes(&state, 1, &named);
    MlirOperation made = checked(mlirOperationCreate(&state), constantName);
    mlirBlockInsertOwnedOperation(block.handle, 0, made);
    return {mlirOperationGetResult(made, 0)};
  }

  /// Moves all ops of `block` to the end of the current block.
  void splice(Block block) {
    MlirOperation op = mlirBlockGetFirstOperation(block.handle);
    while (!mlirOperationIsNull(op)) {
      MlirOperation next = mlirOperationGetNextInBlock(op);
      mlirOperationRemoveFromParent(op);
      mlirBlockAppendOwnedOperation(current, op);
      op = next;
    }
  }

  /// Lists the names of the ops of a block, nested ones excluded.
  std::vector<std::string> opNames(Block block) {
    std::vector<std::string> names;
    for (MlirOperation op = mlirBlockGetFirstOperation(block.handle);
         !mlirOperationIsNull(op); op = mlirOperationGetNextInBlock(op)) {
      MlirStringRef name = mlirIdentifierStr(mlirOperationGetName(op));
      names.emplace_back(name.data, name.length);
    }
    return names;
  }

  void enterModule() { current = mlirModuleGetBody(module); }

  std::string text(bool locations) {
    std::string result;
    MlirOpPrintingFlags flags = mlirOpPrintingFlagsCreate();
    if (locations)
      mlirOpPrintingFlagsEnableDebugInfo(flags, true, /*prettyForm=*/false);
    mlirOperationPrintWithFlags(mlirModuleGetOperation(module), flags,
                                appendText, &result);
    mlirOpPrintingFlagsDestroy(flags);
    return result;
  }

  bool verify() { return mlirOperationVerify(mlirModuleGetOperation(module)); }

  std::shared_ptr<Kernel> finish(const std::string &name) {
    dropRegions(); // they may use values of the module
    TaiKernel kernel = nullptr;
    MlirModule owned = module;
    module.ptr = nullptr; // the kernel owns it, also on failure
    context->check(
        taiKernelCreate(context->handle, owned, name.c_str(), &kernel));
    return std::make_shared<Kernel>(context, kernel);
  }

private:
  /// Destroys the regions that no op took: the front end did not need them, or
  /// reported an error. Inner regions use values of outer regions, and go
  /// first.
  void dropRegions() {
    for (auto region = regions.rbegin(); region != regions.rend(); ++region)
      if ((*region)->handle.ptr)
        mlirRegionDestroy((*region)->handle);
    regions.clear();
  }

  MlirOperation checked(MlirOperation op, const std::string &name) {
    if (mlirOperationIsNull(op))
      throw std::runtime_error("the op " + name + " could not be built");
    return op;
  }

  MlirOperation create(const std::string &name, const py::sequence &operands,
                       const py::sequence &resultTypes, const py::object &attrs,
                       const py::object &ownedRegions) {
    MlirOperationState state = mlirOperationStateGet(toRef(name), location);
    std::vector<MlirValue> values;
    for (py::handle operand : operands)
      values.push_back(operand.cast<const Value &>().handle);
    mlirOperationStateAddOperands(&state, static_cast<intptr_t>(values.size()),
                                  values.data());
    std::vector<MlirType> resultHandles;
    for (py::handle result : resultTypes)
      resultHandles.push_back(result.cast<const Type &>().handle);
    mlirOperationStateAddResults(&state,
                                 static_cast<intptr_t>(resultHandles.size()),
                                 resultHandles.data());
    std::vector<MlirNamedAttribute> named;
    if (!attrs.is_none())
      for (auto [key, value] : attrs.cast<py::dict>())
        named.push_back(mlirNamedAttributeGet(
            mlirIdentifierGet(mlir, toRef(key.cast<std::string>())),
            value.cast<const Attribute &>().handle));
    mlirOperationStateAddAttributes(&state, static_cast<intptr_t>(named.size()),
                                    named.data());
    std::vector<MlirRegion> owned;
    if (!ownedRegions.is_none())
      for (py::handle region : ownedRegions.cast<py::sequence>()) {
        auto reference = region.cast<RegionRef>();
        owned.push_back(reference->handle);
        reference->handle.ptr = nullptr;
      }
    mlirOperationStateAddOwnedRegions(
        &state, static_cast<intptr_t>(owned.size()), owned.data());
    return checked(mlirOperationCreate(&state), name);
  }

  py::object results(MlirOperation op) {
    intptr_t count = mlirOperationGetNumResults(op);
    if (count == 0)
      return py::none();
    if (count == 1)
      return py::cast(Value{mlirOperationGetResult(op, 0)});
    py::tuple all(count);
    for (intptr_t i = 0; i < count; ++i)
      all[i] = Value{mlirOperationGetResult(op, i)};
    return all;
  }

  const std::string constantName = "arith.constant";
  ContextRef context;
  MlirContext mlir;
  std::string file;
  MlirLocation location;
  MlirModule module;
  MlirBlock current{nullptr};
  std::vector<RegionRef> regions;
  std::unordered_map<std::string, MlirType> types;
  std::unordered_map<std::string, MlirAttribute> attributes;
};

} // namespace

void taipy::bindBuilder(py::module_ &module) {
  py::class_<Type>(module, "Type");
  py::class_<Attribute>(module, "Attribute");
  py::class_<Value>(module, "Value");
  py::class_<Block>(module, "Block")
      .def("argument",
           [](Block &block, intptr_t i) {
             return Value{mlirBlockGetArgument(block.handle, i)};
           })
      .def("is_empty", [](Block &block) {
        return mlirOperationIsNull(mlirBlockGetFirstOperation(block.handle));
      });
  py::class_<Region, RegionRef>(module, "Region");
  py::class_<Builder>(module, "Builder")
      .def(py::init<ContextRef, const std::string &>())
      .def("set_file", &Builder::setFile)
      .def("set_location", &Builder::setLocation)
      .def("type", &Builder::type)
      .def("attribute", &Builder::attribute)
      .def("string", &Builder::stringAttribute)
      .def("number", &Builder::number)
      .def("region", &Builder::region)
      .def("block", &Builder::block, py::arg("region"), py::arg("arguments"),
           py::arg("names") = std::vector<std::string>())
      .def("set_block", &Builder::setBlock)
      .def("get_block", &Builder::getBlock)
      .def("op", &Builder::op, py::arg("name"), py::arg("operands"),
           py::arg("results") = py::tuple(), py::arg("attrs") = py::none(),
           py::arg("regions") = py::none())
      .def("constant", &Builder::constant)
      .def("splice", &Builder::splice)
      .def("op_names", &Builder::opNames)
      .def("enter_module", &Builder::enterModule)
      .def("text", &Builder::text, py::arg("locations") = false)
      .def("verify", &Builder::verify)
      .def("finish", &Builder::finish);
}
