//===- ShadowReports.cpp - Reports of shadow execution --------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "ShadowReports.h"
#include "ShadowOps.h"

using namespace mlir;
using namespace mlir::tai;

/// Branch weight: tests that do not call the runtime for each test that does.
/// It makes LLVM save registers at the calls rather than before the tests.
static constexpr uint32_t kSilentToTold = 1000;
/// The most sites of a function that have counts of their own, which take 64
/// KiB of its stack.
static constexpr size_t kMostCounts = 2048;
static constexpr int64_t kMostLanes = 64;

/// Returns the address of the description of `op`: "operation
/// kernel
/// place".
Value ShadowReports::describe(Operation *op) {
  // Functions made from loops have names like k.loop0, which contain the name
  // of the kernel.
  StringRef kernel = function.getName();
  if (size_t end = kernel.rfind(".loop"); end != StringRef::npos)
    kernel = kernel.take_front(end);
  std::string text = nameOperation(op) + "\n" + kernel.str() + "\n" +
                     describePlace(op->getLoc());
  text.push_back('\0');
  // Room is reserved in front of the text for the runtime's data
  // (TaiShadowSite).
  text.insert(0, sizeof(TaiShadowSite), '\0');
  LLVM::GlobalOp &global = texts[text];
  if (!global) {
    auto module = function->getParentOfType<ModuleOp>();
    auto top = OpBuilder::atBlockBegin(module.getBody());
    global = LLVM::GlobalOp::create(
        top, module.getLoc(),
        LLVM::LLVMArrayType::get(b.getI8Type(), text.size()),
        /*isConstant=*/false, LLVM::Linkage::Internal,
        "tai.site." + std::to_string(texts.size()), b.getStringAttr(text),
        alignof(TaiShadowSite));
  }
  return LLVM::AddressOfOp::create(b, global);
}

std::optional<int32_t> ShadowReports::getCount(Value site) {
  auto name =
      site.getDefiningOp<LLVM::AddressOfOp>().getGlobalNameAttr().getAttr();
  auto found = numbersOfSites.find(name);
  if (found != numbersOfSites.end())
    return found->second;
  if (numbersOfSites.size() == kMostCounts)
    return std::nullopt;
  if (!counts) {
    OpBuilder::InsertionGuard guard(b);
    b.setInsertionPointToStart(&function.getBody().front());
    // finish() sets the size.
    counts = LLVM::AllocaOp::create(b, runtime.getPointerType(), b.getI8Type(),
                                    integer(64, 0), /*alignment=*/64);
  }
  auto number = static_cast<int32_t>(numbersOfSites.size());
  numbersOfSites[name] = number;
  return number;
}

Value ShadowReports::emitMember(int32_t count, size_t offset) {
  size_t bytes =
      sizeof(TaiShadowCounts) + count * sizeof(TaiShadowCount) + offset;
  return LLVM::GEPOp::create(b, runtime.getPointerType(), b.getI8Type(), counts,
                             ArrayRef<LLVM::GEPArg>{int32_t(bytes)});
}

void ShadowReports::emitAdd(int32_t count, size_t offset, Value more) {
  Value address = emitMember(count, offset);
  Value before = LLVM::LoadOp::create(b, b.getI64Type(), address);
  LLVM::StoreOp::create(b, LLVM::AddOp::create(b, before, more), address);
}

void ShadowReports::emitIf(Value condition, bool isRare,
                           llvm::function_ref<void()> emit) {
  Block *here = b.getInsertionBlock();
  Block *rest = here->splitBlock(b.getInsertionPoint());
  Block *then = b.createBlock(rest);
  b.setInsertionPointToEnd(here);
  if (isRare)
    LLVM::CondBrOp::create(b, condition, then, ValueRange(), rest, ValueRange(),
                           std::make_pair(uint32_t(1), kSilentToTold));
  else
    LLVM::CondBrOp::create(b, condition, then, rest);
  b.setInsertionPointToEnd(then);
  emit();
  LLVM::BrOp::create(b, rest);
  b.setInsertionPointToStart(rest);
}

/// Emits the test whether the error is finite and smaller than the worst error
/// of the site so far. False for NaN and infinities, whose errors are not
/// finite.
Value ShadowReports::emitIsCommon(int32_t count, const Numbers &numbers) {
  Value reach = LLVM::LoadOp::create(
      b, b.getF64Type(), emitMember(count, offsetof(TaiShadowCount, reach)));
  reach = emitSplat(b, reach, numbers.exact.getType());
  Value most =
      LLVM::FMulOp::create(b, reach, LLVM::FAbsOp::create(b, numbers.exact));
  return LLVM::FCmpOp::create(b, LLVM::FCmpPredicate::olt,
                              LLVM::FAbsOp::create(b, numbers.error), most);
}

/// Emits the test whether both operands are at least eight times as large as
/// the result.
Value ShadowReports::emitCancels(const Numbers &numbers) {
  Value eight = emitSplat(b, LLVM::ConstantOp::create(b, b.getF64FloatAttr(8)),
                          numbers.result.getType());
  Value most =
      LLVM::FMulOp::create(b, LLVM::FAbsOp::create(b, numbers.result), eight);
  auto isLarge = [&](Value operand) -> Value {
    return LLVM::FCmpOp::create(b, LLVM::FCmpPredicate::ogt,
                                LLVM::FAbsOp::create(b, operand), most);
  };
  return LLVM::AndOp::create(b, isLarge(numbers.a), isLarge(numbers.b));
}

void ShadowReports::emitResult(Operation *op, unsigned precision, Value fires,
                               const Numbers &numbers) {
  Value site = describe(op);
  std::optional<int32_t> count = getCount(site);
  Value bits = integer(32, precision);
  if (isa<VectorType>(fires.getType()))
    return emitLanes(site, count, bits, fires, numbers);
  auto call = [&] {
    Value frame = function.getArgument(0);
    Value own = count ? Value(counts) : runtime.null(b, b.getLoc());
    runtime.tai_rt_shadow_site(
        b, b.getLoc(), frame, site, own, integer(32, count.value_or(0)), bits,
        integer(32, 1), numbers.a, numbers.errorOfA, numbers.b,
        numbers.errorOfB, numbers.result, numbers.error, numbers.exact);
  };
  if (!count)
    return call();
  Value isCommon = emitIsCommon(*count, numbers);
  Value yes = LLVM::ConstantOp::create(b, b.getI1Type(), true);
  Value one = LLVM::ZExtOp::create(b, b.getI64Type(), isCommon);
  emitAdd(*count, offsetof(TaiShadowCount, lost), one);
  if (!numbers.isUnary) {
    Value cancels = LLVM::AndOp::create(b, isCommon, emitCancels(numbers));
    emitAdd(*count, offsetof(TaiShadowCount, cancellations),
            LLVM::ZExtOp::create(b, b.getI64Type(), cancels));
  }
  emitIf(LLVM::XOrOp::create(b, isCommon, yes), /*isRare=*/true, call);
}

/// Emits the boolean lanes of a vector as the bits of an i64.
static Value emitMask(ImplicitLocOpBuilder &b, Value lanes) {
  auto type = cast<VectorType>(lanes.getType());
  Value bits = LLVM::BitcastOp::create(
      b, b.getIntegerType(type.getNumElements()), lanes);
  if (type.getNumElements() == 64)
    return bits;
  return LLVM::ZExtOp::create(b, b.getI64Type(), bits);
}

void ShadowReports::emitLanes(Value site, std::optional<int32_t> count,
                              Value precision, Value fires,
                              const Numbers &numbers) {
  auto type = cast<VectorType>(numbers.exact.getType());
  int64_t width = type.getNumElements();
  Value own = count ? Value(counts) : runtime.null(b, b.getLoc());
  Value frame = function.getArgument(0);
  Value index = integer(32, count.value_or(0));
  Value all[] = {numbers.a,        numbers.errorOfA, numbers.b,
                 numbers.errorOfB, numbers.result,   numbers.error,
                 numbers.exact};
  if (width > kMostLanes) {
    for (int32_t lane = 0; lane < width; ++lane) {
      auto pick = [&](Value vector) -> Value {
        return LLVM::ExtractElementOp::create(b, vector, integer(32, lane));
      };
      Value told = LLVM::ZExtOp::create(b, b.getI32Type(), pick(fires));
      runtime.tai_rt_shadow_site(b, b.getLoc(), frame, site, own, index,
                                 precision, told, pick(all[0]), pick(all[1]),
                                 pick(all[2]), pick(all[3]), pick(all[4]),
                                 pick(all[5]), pick(all[6]));
    }
    return;
  }
  Value told = emitMask(b, fires);
  if (count) {
    Value isCommon =
        LLVM::AndOp::create(b, fires, emitIsCommon(*count, numbers));
    auto add = [&](size_t offset, Value lanes) {
      emitAdd(*count, offset, LLVM::CtPopOp::create(b, emitMask(b, lanes)));
    };
    add(offsetof(TaiShadowCount, lost), isCommon);
    if (!numbers.isUnary)
      add(offsetof(TaiShadowCount, cancellations),
          LLVM::AndOp::create(b, isCommon, emitCancels(numbers)));
    told = LLVM::XOrOp::create(b, told, emitMask(b, isCommon));
  }
  mostLanes = std::max(mostLanes, width);
  if (!lanes) {
    OpBuilder::InsertionGuard guard(b);
    b.setInsertionPointToStart(&function.getBody().front());
    lanes = LLVM::AllocaOp::create(b, runtime.getPointerType(), b.getF64Type(),
                                   integer(64, 0), /*alignment=*/64);
  }
  Value some =
      LLVM::ICmpOp::create(b, LLVM::ICmpPredicate::ne, told, integer(64, 0));
  emitIf(some, /*isRare=*/true, [&] {
    for (auto [i, vector] : llvm::enumerate(all)) {
      Value address = LLVM::GEPOp::create(
          b, runtime.getPointerType(), b.getF64Type(), lanes,
          ArrayRef<LLVM::GEPArg>{int32_t(int64_t(i) * width)});
      LLVM::StoreOp::create(b, vector, address, /*alignment=*/8);
    }
    runtime.tai_rt_shadow_lanes(b, b.getLoc(), frame, site, own, index,
                                precision, integer(32, width), told, lanes);
  });
}

void ShadowReports::emitFlip(Operation *op, unsigned precision,
                             const Numbers &numbers) {
  runtime.tai_rt_shadow_flip(b, b.getLoc(), function.getArgument(0),
                             describe(op), integer(32, precision), numbers.a,
                             numbers.errorOfA, numbers.b, numbers.errorOfB);
}

static void setSize(ImplicitLocOpBuilder &b, LLVM::AllocaOp room,
                    int64_t size) {
  b.setInsertionPoint(room);
  room.getArraySizeMutable().assign(
      LLVM::ConstantOp::create(b, b.getI64Type(), size));
}

void ShadowReports::finish() {
  OpBuilder::InsertionGuard guard(b);
  b.setLoc(function.getLoc());
  if (lanes)
    setSize(b, lanes, 7 * mostLanes);
  if (!counts)
    return;
  auto sites = static_cast<int64_t>(numbersOfSites.size());
  auto size = static_cast<int64_t>(sizeof(TaiShadowCounts) +
                                   sites * sizeof(TaiShadowCount));
  setSize(b, counts, size);
  b.setInsertionPointAfter(counts);
  LLVM::MemsetOp::create(b, counts, integer(8, 0), integer(64, size),
                         /*isVolatile=*/false);
  SmallVector<LLVM::ReturnOp> returns;
  function.walk([&](LLVM::ReturnOp op) { returns.push_back(op); });
  for (LLVM::ReturnOp op : returns) {
    b.setInsertionPoint(op);
    Value any = LLVM::LoadOp::create(b, b.getI64Type(), counts);
    any = LLVM::ICmpOp::create(b, LLVM::ICmpPredicate::ne, any, integer(64, 0));
    emitIf(any, /*isRare=*/false, [&] {
      runtime.tai_rt_shadow_counted(b, b.getLoc(), function.getArgument(0),
                                    counts, integer(32, sites));
    });
  }
}

void ShadowReports::restrictEffects(ModuleOp module) {
  MLIRContext *context = module.getContext();
  auto none = LLVM::ModRefInfo::NoModRef, both = LLVM::ModRefInfo::ModRef;
  // The reporting functions access memory of their arguments and memory of the
  // runtime, such as all memory reached through the frame.
  auto effects = LLVM::MemoryEffectsAttr::get(
      context, {none, both, both, none, none, none});
  for (StringRef name : {"tai_rt_shadow_site", "tai_rt_shadow_lanes",
                         "tai_rt_shadow_flip", "tai_rt_shadow_counted"}) {
    auto callee = module.lookupSymbol<LLVM::LLVMFuncOp>(name);
    if (!callee)
      continue;
    callee.setWillReturn(true);
    callee.setMemoryEffectsAttr(effects);
    for (unsigned i = 0, e = callee.getNumArguments(); i < e; ++i)
      if (isa<LLVM::LLVMPointerType>(callee.getArgumentTypes()[i]))
        callee.setArgAttr(i, LLVM::LLVMDialect::getNoCaptureAttrName(),
                          UnitAttr::get(context));
  }
}
