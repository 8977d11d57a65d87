//===- Foreign.h - Functions of other compilers -----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Differentiation handles scf, memref, arith, math and parts of vector. A
// `func.func` with other ops is copied, and upstream passes lower the copy.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_AD_FOREIGN_FOREIGN_H
#define TAI_AD_FOREIGN_FOREIGN_H

#include "mlir/Dialect/Func/IR/FuncOps.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "tai/Analysis/HelpfulPasses.h"

namespace mlir::tai {
struct AdjointSignature;

/// The function to which the derivative of `function` belongs: the original of
/// a prepared copy, and otherwise `function` itself.
FunctionOpInterface getOriginal(FunctionOpInterface function);
/// Removes the prepared copies of functions, on which the differentiation of
/// other compilers' code works.
void erasePrepared(ModuleOp module);

/// The attribute of a function whose derivative is two functions: a unit, or
/// the names of the two functions once they are made.
constexpr llvm::StringLiteral kSplit = "tai.split";
/// True if a split derivative has been made: both of its functions exist.
bool isSplit(FunctionOpInterface function);

/// True if the derivative of the original has other arguments and results than
/// the derivative of its copy: values in place of memory.
bool isWrapped(FunctionOpInterface prepared);
/// Wraps the derivative of a prepared copy, whose arguments are memory, in a
/// function of the original's values: tensors and numbers.
func::FuncOp wrapDerivative(func::FuncOp original, func::FuncOp derivative,
                            bool isForward);

/// Gives a function memory in place of the numbers that `signature` names among
/// its arguments, and in place of its results: forward mode gives memory
/// tangents.
void passNumbers(func::FuncOp function, const AdjointSignature &signature);
/// Wraps the derivative of such a function in one that takes the arguments of
/// the original and a tangent of each that is named, and returns the results
/// and the tangent of each that is named.
func::FuncOp wrapNumbers(func::FuncOp original, func::FuncOp derivative,
                         const AdjointSignature &signature);

/// Gives a derivative the visibility and the C interface of the differentiated
/// function.
void takeInterface(func::FuncOp original, func::FuncOp derivative);

/// Replaces vector reads and writes of memory, and some ops on vectors, by ops
/// on single elements.
LogicalResult lowerVectors(func::FuncOp function);

/// Replaces loops of kinds that have no derivative: those with unsigned bounds
/// by loops that count from zero, and those of `gpu.launch` by `scf.parallel`.
void lowerLoops(func::FuncOp function);

/// True if the function makes arrays of complex numbers.
bool hasComplexArrays(func::FuncOp function);
/// Replaces complex numbers, and arrays of them that the function makes, by
/// their real and imaginary parts.
LogicalResult splitComplex(func::FuncOp function);
/// Replaces arithmetic of the LLVM dialect by ops of arith and math.
void liftArithmetic(func::FuncOp function);

/// Makes one array before each loop or branch that carries or yields arrays
/// made inside of it, and copies these to it. An array that is written is one
/// of these only if `areTensors`: then nobody else reads its old contents.
void keepMadeArrays(func::FuncOp function, bool areTensors);

/// Reduces memory operations to loads, stores and atomic updates of arguments
/// and of local arrays: removes copies, views, and arrays that loops carry or
/// branches choose. Local arrays are freed at the end of their blocks.
LogicalResult normalizeMemory(func::FuncOp function);

/// Replaces a parallel loop by nested serial loops.
void serialize(scf::ParallelOp loop);

} // namespace mlir::tai

#endif // TAI_AD_FOREIGN_FOREIGN_H
