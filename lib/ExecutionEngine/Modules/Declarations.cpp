//===- Declarations.cpp - Trees and fields of a session -------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/ExecutionEngine/Modules/Declarations.h"
#include "mlir/AsmParser/AsmParser.h"
#include "mlir/IR/DialectResourceBlobManager.h"
#include "mlir/IR/Verifier.h"
#include "tai/Dialect/Mesh/IR/Mesh.h"
#include "tai/ExecutionEngine/Modules/ModuleFile.h"
#include "tai/Runtime/Launch/Mesh.h"
#include "tai/Runtime/Mirror/Mirror.h"
#include "llvm/ADT/SetVector.h"
#include "llvm/ADT/StringSet.h"

using namespace mlir;
using namespace mlir::tai;

Declarations::Declarations(MLIRContext *context, runtime::Runtime &runtime,
                           FailureLog &failures)
    : context(context), rt(runtime), failures(failures),
      declared(ModuleOp::create(UnknownLoc::get(context))), symbols(*declared),
      dataLayout(*declared) {}

int64_t Declarations::size() const {
  return llvm::range_size(declared.get().getBody()->getOperations());
}

//===----------------------------------------------------------------------===//
// Trees
//===----------------------------------------------------------------------===//

LogicalResult Declarations::addTree(StringRef name, StringRef layout) {
  DiagnosticCollector collector(context);
  size_t read = 0;
  Type type;
  if (checkText(layout, context, "layout"))
    type = parseType(layout, context, &read, /*isKnownNullTerminated=*/false);
  if (!type)
    return failures.fail(collector.take(
        FailureKind::Syntax, "the layout '" + layout + "' does not parse"));
  if (!layout.substr(read).trim().empty())
    return failures.fail(FailureKind::Syntax,
                         "the layout of '" + name + "' ends with '" +
                             layout.substr(read).trim() +
                             "', which does not belong to it");
  auto root = dyn_cast<RootType>(type);
  if (!root)
    return failures.fail(FailureKind::Type,
                         "the layout of a tree is a !tai.root type, but got '" +
                             layout + "'");
  OpBuilder builder(context);
  OperationState state(UnknownLoc::get(context), TreeOp::getOperationName());
  state.addAttribute("sym_name", builder.getStringAttr(name));
  state.addAttribute("layout", TypeAttr::get(root));
  OwningOpRef<TreeOp> tree(cast<TreeOp>(builder.create(state)));
  return addTree(*tree);
}

/// Describes each sparse level for messages, such as "the 'pointer' level above
/// @x, @v".
static std::vector<std::string> describeNodes(RootType root,
                                              ArrayRef<SparseNode> nodes) {
  struct Places {
    unsigned count = 0;
    std::string names;
  };
  llvm::DenseMap<ArrayRef<unsigned>, Places> placesBelow;
  for (const SparseNode &node : nodes)
    placesBelow.try_emplace(node.position);
  walkPlaces(root, [&](const PlacePath &path) {
    SmallVector<unsigned> position;
    for (const PathLevel &level : path.levels) {
      position.push_back(level.child);
      auto found = placesBelow.find(ArrayRef(position));
      if (found == placesBelow.end() || ++found->second.count > 3)
        continue;
      std::string &names = found->second.names;
      names += names.empty() ? "@" : ", @";
      names += path.places.getNames()[path.place].getValue();
    }
  });
  std::vector<std::string> labels;
  for (const SparseNode &node : nodes) {
    const Places &places = placesBelow.find(node.position)->second;
    std::string &label = labels.emplace_back();
    llvm::raw_string_ostream os(label);
    os << "the '" << node.type.getKind() << "' level above " << places.names;
    if (places.count > 3)
      os << " and " << places.count - 3 << " more";
  }
  return labels;
}

/// Describes the sparse levels of a tree for the runtime.
static std::vector<runtime::SparseInfo> describeSparse(RootType root,
                                                       TreeLayout &layout) {
  std::vector<runtime::SparseInfo> infos;
  ArrayRef<SparseNode> nodes = layout.getSparseNodes();
  for (auto [node, label] : llvm::zip(nodes, describeNodes(root, nodes))) {
    runtime::SparseInfo info;
    info.label = label;
    info.isList = node.type.isList();
    info.parent = node.parent ? int(*node.parent) : -1;
    for (const SparseNode::Step &step : node.steps)
      info.steps.push_back({step.cells, static_cast<int64_t>(step.stride)});
    info.offset = node.offset;
    info.activityOffset = node.activityOffset;
    infos.push_back(std::move(info));
  }
  return infos;
}

LogicalResult Declarations::addTree(TreeOp tree) {
  StringRef name = tree.getSymName();
  DiagnosticCollector collector(context);
  if (symbols.lookup(name))
    return failures.fail(FailureKind::Usage,
                         "'" + name + "' is already declared");
  if (failed(verify(tree)))
    return failures.fail(
        collector.take(FailureKind::Type, "'" + name + "' is invalid"));
  RootType root = tree.getLayout();
  auto layout = std::make_unique<TreeLayout>(root, dataLayout);
  runtime::TreePtr made;
  if (failed(failures.check(
          rt.store().addTree(name.str(), layout->getTreeSize().total, made,
                             describeSparse(root, *layout)))))
    return failure();
  symbols.insert(tree.clone());
  layouts[name] = std::move(layout);
  return success();
}

LogicalResult Declarations::destroyTree(StringRef name) {
  if (failed(failures.check(rt.destroyTree(name.str()))))
    return failure();
  llvm::StringSet<> gone;
  for (FieldOp field : llvm::make_early_inc_range(declared->getOps<FieldOp>()))
    if (field.getTree() == name) {
      gone.insert(field.getSymName());
      symbols.erase(field);
    }
  // Names of destroyed fields are dropped from adjoints and duals, because a
  // new field of the same name is a different field.
  for (FieldOp field : declared->getOps<FieldOp>()) {
    if (field.getAdjoint() && gone.contains(*field.getAdjoint()))
      field.removeAdjointAttr();
    if (field.getDual() && gone.contains(*field.getDual()))
      field.removeDualAttr();
  }
  if (Operation *tree = symbols.lookup(name))
    symbols.erase(tree);
  layouts.erase(name);
  return success();
}

//===----------------------------------------------------------------------===//
// Fields
//===----------------------------------------------------------------------===//

FailureOr<runtime::FieldPtr> Declarations::addField(StringRef declaration) {
  DiagnosticCollector collector(context);
  // The field is verified later, because the text lacks the declarations of the
  // field's adjoint and tree.
  ParserConfig config(context, /*verifyAfterParse=*/false);
  OwningOpRef<ModuleOp> module = readModule(declaration, config, "declaration");
  if (!module)
    return failures.fail(
        collector.take(FailureKind::Syntax, "the declaration does not parse"));
  Block *body = module->getBody();
  if (!llvm::hasSingleElement(*body) || !isa<FieldOp>(body->front()))
    return failures.fail(FailureKind::Syntax,
                         "a declaration is one 'tai.field' op, but got '" +
                             declaration + "'");
  return addField(cast<FieldOp>(body->front()));
}

/// Verifies a field with its verified tree, but without its adjoint and dual,
/// which may be declared later. The layout refers to the copies in `scratch`.
static FailureOr<FieldLayout> verifyAlone(FieldOp field, TreeOp tree,
                                          OwningOpRef<ModuleOp> &scratch) {
  scratch = ModuleOp::create(field.getLoc());
  scratch->push_back(tree.clone());
  FieldOp copy = field.clone();
  copy.removeAdjointAttr();
  copy.removeDualAttr();
  scratch->push_back(copy);
  SymbolTableCollection tables;
  if (failed(verify(copy)) || failed(copy.verifySymbolUses(tables)))
    return failure();
  return getFieldLayout(copy);
}

static std::optional<runtime::ScalarKind> getScalarKind(Type type) {
  using Kind = runtime::ScalarKind;
  if (type.isInteger(1))
    return Kind::I1;
  if (type.isInteger(8))
    return Kind::I8;
  if (type.isInteger(16))
    return Kind::I16;
  if (type.isInteger(32))
    return Kind::I32;
  if (type.isInteger(64))
    return Kind::I64;
  if (type.isF16())
    return Kind::F16;
  if (type.isBF16())
    return Kind::BF16;
  if (type.isF32())
    return Kind::F32;
  if (type.isF64())
    return Kind::F64;
  return std::nullopt;
}

/// Returns the initial contents of the field as a row-major array; nullopt
/// after an error.
static std::optional<std::vector<char>>
getContents(FieldOp field, runtime::ScalarKind scalar) {
  std::vector<char> array;
  ElementsAttr initial = field.getInitialAttr();
  if (!initial)
    return array;
  auto count = static_cast<size_t>(initial.getNumElements());
  auto size = static_cast<size_t>(runtime::byteSize(scalar));
  array.reserve(count * size);
  if (auto dense = dyn_cast<DenseElementsAttr>(initial)) {
    if (dense.getElementType().isInteger(1)) {
      for (bool value : dense.getValues<bool>())
        array.push_back(value);
      return array;
    }
    // The raw data of a splat attribute holds a single element.
    ArrayRef<char> raw = dense.getRawData();
    for (size_t i = 0, e = dense.isSplat() ? count : 1; i != e; ++i)
      array.insert(array.end(), raw.begin(), raw.end());
  } else if (AsmResourceBlob *blob = cast<DenseResourceElementsAttr>(initial)
                                         .getRawHandle()
                                         .getBlob()) {
    ArrayRef<char> raw = blob->getData();
    array.assign(raw.begin(), raw.end());
  }
  if (array.size() == count * size)
    return array;
  field.emitError("the initial contents of '@")
      << field.getSymName() << "' have " << array.size()
      << " bytes, but its elements take " << count * size;
  return std::nullopt;
}

FailureOr<runtime::FieldPtr> Declarations::addField(FieldOp field) {
  StringRef name = field.getSymName();
  if (symbols.lookup(name))
    return failures.fail(FailureKind::Usage,
                         "'" + name + "' is already declared");
  auto tree = symbols.lookup<TreeOp>(field.getTree());
  if (!tree)
    return failures.fail(FailureKind::Usage,
                         "field '" + name + "' names the tree '" +
                             field.getTree() + "', which is not there");
  DiagnosticCollector collector(context);
  OwningOpRef<ModuleOp> scratch;
  FailureOr<FieldLayout> layout = verifyAlone(field, tree, scratch);
  if (failed(layout))
    return failures.fail(
        collector.take(FailureKind::Type, "field '" + name + "' is invalid"));
  FieldStorage storage =
      layouts.find(field.getTree())->second->getFieldStorage(*layout);
  runtime::FieldInfo info;
  info.name = name.str();
  info.tree = rt.store().findTree(field.getTree().str());
  Type scalar = field.getType();
  if (auto vector = dyn_cast<VectorType>(scalar)) {
    scalar = vector.getElementType();
    info.layout.elementShape.assign(vector.getShape().begin(),
                                    vector.getShape().end());
  }
  std::optional<runtime::ScalarKind> kind = getScalarKind(scalar);
  if (!kind) {
    field.emitError() << "fields of " << scalar << " cannot be run";
    return failures.fail(collector.take(FailureKind::Type));
  }
  std::optional<std::vector<char>> contents = getContents(field, *kind);
  if (!contents)
    return failures.fail(collector.take(FailureKind::Type));
  info.layout.scalar = *kind;
  info.layout.placeOffset = storage.offset;
  info.layout.indices.resize(layout->shape.size());
  unsigned innermost = 0;
  if (!storage.sparse.empty()) {
    innermost = storage.sparse.back().level + 1;
    info.layout.sparseNode = storage.sparse.back().node;
  }
  for (const IndexDigit &digit : storage.digits) {
    // The number of cells of the innermost sparse level in one step of the
    // digit: zero for digits below that level.
    int64_t cells = digit.level < innermost ? digit.weight : 0;
    for (unsigned level = digit.level + 1; level < innermost; ++level)
      cells *= layout->path.levels[level].type.getNumCells();
    info.layout.indices[digit.dimension].push_back(
        {digit.divisor, digit.extent, static_cast<int64_t>(digit.stride),
         cells});
  }
  info.layout.offset.assign(layout->offset.begin(), layout->offset.end());
  if (field.getAdjoint())
    info.adjoint = field.getAdjoint()->str();
  if (field.getDual())
    info.dual = field.getDual()->str();
  runtime::FieldPtr made;
  if (failed(failures.check(rt.store().addField(std::move(info), made))))
    return failure();
  if (runtime::Mirror *mirror = made->tree().mirror()) {
    std::optional<Sharding> sharding = getSharding(*layout);
    std::optional<int64_t> rank = runtime::rankOfProcess();
    std::optional<runtime::OwnedIndices> part;
    if (sharding && rank && sharding->ranks > 1)
      part = {static_cast<int>(sharding->dimension), *rank * sharding->block,
              sharding->block};
    mirror->noteField(*made, part);
  }
  // Kernels see the declaration without its initial contents, on which no
  // kernel depends.
  FieldOp declaration = field.clone();
  declaration.removeInitialAttr();
  symbols.insert(declaration);
  if (!contents->empty() &&
      failed(failures.check(rt.writes().copyIn(*made, contents->data()))))
    return failure();
  return made;
}

//===----------------------------------------------------------------------===//
// What kernels use
//===----------------------------------------------------------------------===//

LogicalResult Declarations::declareUsed(ModuleOp module) {
  // The declarations are added in the order of first use, so that the module,
  // and with it the key of its cached code, does not depend on other contents
  // of the session.
  llvm::SetVector<StringAttr> pending;
  module.walk([&](Operation *op) {
    op->getAttrDictionary().walk([&](SymbolRefAttr symbol) {
      pending.insert(symbol.getRootReference());
    });
  });
  SmallVector<Operation *> used;
  for (size_t i = 0; i < pending.size(); ++i) {
    StringAttr name = pending[i];
    Operation *held = SymbolTable::lookupSymbolIn(module, name);
    Operation *known = symbols.lookup(name);
    if (auto tree = dyn_cast_or_null<TreeOp>(held)) {
      auto knownTree = dyn_cast_or_null<TreeOp>(known);
      if (!knownTree || knownTree.getLayout() != tree.getLayout())
        return failures.fail(FailureKind::Usage,
                             "the tree '" + name.getValue() +
                                 "' of the module is not that of the context");
    }
    Operation *op = held ? held : known;
    if (!held && known)
      used.push_back(known);
    if (auto field = dyn_cast_or_null<FieldOp>(op))
      for (NamedAttribute attribute : field->getAttrs())
        if (auto symbol = dyn_cast<SymbolRefAttr>(attribute.getValue()))
          pending.insert(symbol.getRootReference());
  }
  OpBuilder builder = OpBuilder::atBlockBegin(module.getBody());
  for (bool wantTrees : {true, false})
    for (Operation *op : used)
      if (isa<TreeOp>(op) == wantTrees)
        builder.clone(*op);
  return success();
}
