//===- RandomNumbers.cpp - Numbers, bits and values of tai.random ---------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A random number is a function of its position alone: seed, launch, iteration,
// op, and how many numbers the op has drawn before in this iteration
// (tai/Support/Philox.h). Host code computes the number in place, in ten rounds
// of two products, so that loops around it can be vectorised; device code calls
// the device library, which is linked into it.
//
//===----------------------------------------------------------------------===//

#include "mlir/IR/ImplicitLocOpBuilder.h"
#include "tai/Conversion/TaiToHost/Lowering.h"
#include "tai/Transforms/Utils/IndexMath.h"

using namespace mlir;
using namespace mlir::tai;

//===----------------------------------------------------------------------===//
// Positions
//===----------------------------------------------------------------------===//

/// The attribute of the op that stands for a random draw until it is lowered:
/// the number of its stream. The op is a cast of (iteration, sequence[, seed,
/// launch]) to bits, since named operands would need an op of their own.
static constexpr llvm::StringLiteral kStreamAttrName = "stream";

bool tai::isDraw(UnrealizedConversionCastOp op) {
  return op->hasAttr(kStreamAttrName);
}

void tai::numberDraws(Operation *root, ParallelForOp loop) {
  SmallVector<RandomOp> draws;
  root->walk<WalkOrder::PreOrder>([&](Operation *op) {
    if (op != root && isa<ParallelForOp>(op))
      return WalkResult::skip();
    if (auto draw = dyn_cast<RandomOp>(op))
      draws.push_back(draw);
    return WalkResult::advance();
  });
  if (draws.empty())
    return;

  // The number of an iteration is its row-major position in the box of the
  // loop.
  OpBuilder builder(root->getContext());
  Value iteration;
  Block *start = loop ? &loop.getBody().front() : &root->getRegion(0).front();
  builder.setInsertionPointToStart(start);
  Location loc = root->getLoc();
  IndexMath math(builder, loc);
  iteration = math.constant(0);
  if (loop) {
    for (auto [iv, lower, upper] :
         llvm::zip(loop.getInductionVars(), loop.getLowerBounds(),
                   loop.getUpperBounds()))
      iteration = math.add(math.mul(iteration, math.extent(lower, upper)),
                           math.sub(iv, lower));
  }
  iteration = math.toI64(iteration);

  for (RandomOp draw : draws) {
    bool repeats = draw->getBlock() != start && [&] {
      for (Operation *parent = draw->getParentOp(); parent != root;
           parent = parent->getParentOp())
        if (isa<LoopLikeOpInterface>(parent))
          return true;
      return false;
    }();
    Type i32 = builder.getI32Type();
    bool isDouble = draw.getValue().getType().getIntOrFloatBitWidth() > 32;
    Value counter;
    if (repeats) {
      builder.setInsertionPointToStart(start);
      counter = AllocaOp::create(builder, loc,
                                 LocalType::get(root->getContext(), i32));
    }
    builder.setInsertionPoint(draw);
    auto constant = [&](int64_t value) -> Value {
      return arith::ConstantIntOp::create(builder, draw.getLoc(), value, 32);
    };
    Value sequence =
        repeats ? LocalLoadOp::create(builder, draw.getLoc(), i32, counter)
                      .getResult()
                : constant(0);
    if (repeats) {
      Value next = arith::AddIOp::create(builder, draw.getLoc(), sequence,
                                         constant(isDouble ? 2 : 1));
      LocalStoreOp::create(builder, draw.getLoc(), next, counter);
    }
    // Iteration and sequence are operands of the cast, which closures capture
    // like any other operand.
    auto carrier = UnrealizedConversionCastOp::create(
        builder, draw.getLoc(), draw.getValue().getType(),
        ValueRange{iteration, sequence});
    carrier->setAttr(kStreamAttrName, draw.getStreamAttr());
    draw.replaceAllUsesWith(carrier.getResult(0));
    draw.erase();
  }
}

//===----------------------------------------------------------------------===//
// Bits
//===----------------------------------------------------------------------===//

namespace {
/// Emits the functions of tai/Support/Philox.h, in the order of their
/// statements.
class PhiloxEmitter {
public:
  PhiloxEmitter(OpBuilder &builder, Location loc)
      : b(loc, builder), i32(b.getI32Type()), i64(b.getI64Type()) {}

  /// Emits the two words of the Philox key that belongs to a launch.
  std::array<Value, 2> getKey(Value seed, Value launch) {
    Value key = arith::AddIOp::create(b, seed, word(0x9E3779B97F4A7C15u));
    key = arith::MulIOp::create(b, fold(key, 30), word(0xBF58476D1CE4E5B9u));
    key = arith::MulIOp::create(b, fold(key, 27), word(0x94D049BB133111EBu));
    key = arith::XOrIOp::create(b, fold(key, 31), launch);
    return {low(key), high(key)};
  }

  /// Emits the four random numbers of a Philox block.
  std::array<Value, 4> getBlock(Value iteration, Value stream, Value block,
                                std::array<Value, 2> key) {
    std::array<Value, 4> bits = {low(iteration), high(iteration), stream,
                                 block};
    for (int round = 0; round < 10; ++round) {
      if (round)
        key = {arith::AddIOp::create(b, key[0], half(0x9E3779B9)),
               arith::AddIOp::create(b, key[1], half(0xBB67AE85))};
      Value product0 = product(0xD2511F53, bits[0]);
      Value product1 = product(0xCD9E8D57, bits[2]);
      bits = {mix(high(product1), bits[1], key[0]), low(product1),
              mix(high(product0), bits[3], key[1]), low(product0)};
    }
    return bits;
  }

  Value half(uint32_t value) {
    return arith::ConstantOp::create(b, b.getI32IntegerAttr(int32_t(value)));
  }

private:
  Value word(uint64_t value) {
    return arith::ConstantOp::create(b, b.getI64IntegerAttr(int64_t(value)));
  }
  Value low(Value value) { return arith::TruncIOp::create(b, i32, value); }
  Value high(Value value) {
    return low(arith::ShRUIOp::create(b, value, word(32)));
  }
  Value fold(Value value, uint64_t shift) {
    Value shifted = arith::ShRUIOp::create(b, value, word(shift));
    return arith::XOrIOp::create(b, value, shifted);
  }
  Value product(uint32_t multiplier, Value value) {
    Value extended = arith::ExtUIOp::create(b, i64, value);
    return arith::MulIOp::create(b, extended, word(multiplier));
  }
  Value mix(Value x, Value y, Value z) {
    return arith::XOrIOp::create(b, arith::XOrIOp::create(b, x, y), z);
  }

  ImplicitLocOpBuilder b;
  Type i32, i64;
};
} // namespace

/// Emits the random number at position `sequence` and, if `count` is two, the
/// next one: two numbers at once are drawn only at even positions.
static std::array<Value, 2> emitBits(UnrealizedConversionCastOp op,
                                     unsigned count, Value frame,
                                     OpBuilder &builder,
                                     RuntimeCalls &runtime) {
  Location loc = op.getLoc();
  Value iteration = op.getOperand(0), sequence = op.getOperand(1);
  // A device function gets seed and launch as operands; a host function loads
  // them from its frame.
  auto key = [&](unsigned number, size_t offset) {
    return op->getNumOperands() > 2
               ? op.getOperand(2 + number)
               : runtime.frameMember(builder, loc, frame, offset,
                                     builder.getI64Type());
  };
  Value seed = key(0, offsetof(TaiFrame, seed));
  Value launch = key(1, offsetof(TaiFrame, launch));
  auto number = cast<IntegerAttr>(op->getAttr(kStreamAttrName));
  Value stream = runtime.i32(builder, loc, number.getInt());

  std::array<Value, 2> numbers;
  if (!isa<ModuleOp>(SymbolTable::getNearestSymbolTable(op))) {
    for (unsigned i = 0; i < count; ++i) {
      Value at = i == 0 ? sequence
                        : arith::AddIOp::create(builder, loc, sequence,
                                                runtime.i32(builder, loc, i))
                              .getResult();
      numbers[i] =
          runtime.call(builder, loc, "tai_rt_random_u32", builder.getI32Type(),
                       {seed, launch, iteration, stream, at},
                       /*pure=*/true);
    }
    return numbers;
  }

  PhiloxEmitter philox(builder, loc);
  Value block = arith::ShRUIOp::create(builder, loc, sequence, philox.half(2));
  std::array<Value, 4> bits =
      philox.getBlock(iteration, stream, block, philox.getKey(seed, launch));
  auto isSet = [&](uint32_t bit) -> Value {
    Value set = arith::AndIOp::create(builder, loc, sequence, philox.half(bit));
    return arith::CmpIOp::create(builder, loc, arith::CmpIPredicate::ne, set,
                                 philox.half(0));
  };
  auto choose = [&](Value condition, Value yes, Value no) -> Value {
    return arith::SelectOp::create(builder, loc, condition, yes, no);
  };
  Value isLast = isSet(2);
  Value even = choose(isLast, bits[2], bits[0]);
  Value odd = choose(isLast, bits[3], bits[1]);
  if (count == 2)
    return {even, odd};
  return {choose(isSet(1), odd, even), Value()};
}

//===----------------------------------------------------------------------===//
// Values
//===----------------------------------------------------------------------===//

Value tai::emitDraw(UnrealizedConversionCastOp op, Value frame,
                    OpBuilder &builder, RuntimeCalls &runtime) {
  Location loc = op.getLoc();
  Type type = op.getResult(0).getType();
  Type i64 = builder.getI64Type();
  unsigned width = type.getIntOrFloatBitWidth();
  bool isLong = width > 32;

  auto [bits, next] = emitBits(op, isLong ? 2 : 1, frame, builder, runtime);
  if (isLong) {
    Value high = arith::ExtUIOp::create(builder, loc, i64, bits);
    Value low = arith::ExtUIOp::create(builder, loc, i64, next);
    high = arith::ShLIOp::create(builder, loc, high,
                                 runtime.i64(builder, loc, 32));
    bits = arith::OrIOp::create(builder, loc, high, low);
  }
  if (isa<IntegerType>(type))
    return width < 32 ? arith::TruncIOp::create(builder, loc, type, bits)
                      : bits;

  // The number gets as many random bits as the significand has, so that
  // rounding never yields 1. This leaves the sign bit zero: vectors of signed
  // integers convert to floats in one instruction, for unsigned integers few
  // processors have one.
  auto floatType = cast<FloatType>(type);
  unsigned kept =
      llvm::APFloat::semanticsPrecision(floatType.getFloatSemantics());
  unsigned available = isLong ? 64 : 32;
  Value shift =
      arith::ConstantIntOp::create(builder, loc, available - kept, available);
  bits = arith::ShRUIOp::create(builder, loc, bits, shift);
  Value number = arith::SIToFPOp::create(builder, loc, type, bits);
  Value scale = arith::ConstantOp::create(
      builder, loc, builder.getFloatAttr(type, std::ldexp(1.0, -int(kept))));
  return arith::MulFOp::create(builder, loc, number, scale);
}
