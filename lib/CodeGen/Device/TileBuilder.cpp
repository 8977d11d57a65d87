//===- TileBuilder.cpp - Emits chains of launches in tiles ----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A cell is identified by its distance from the first cell of the tile, so that
// a neighbour in the overlay is at a constant offset, also for wrapped indices.
// With periodic boundaries, cells beyond a border are copies of cells at the
// opposite border, and are computed redundantly.
//
//===----------------------------------------------------------------------===//

#include "TileBuilder.h"
#include "tai/ABI/DeviceAbi.h"
#include "llvm/IR/InstIterator.h"
#include "llvm/IR/Module.h"
#include "llvm/Transforms/Utils/Cloning.h"

using namespace mlir;
using namespace mlir::tai;
using namespace mlir::tai::runtime;

llvm::Value *mlir::tai::convertSlot(llvm::IRBuilder<> &builder,
                                    llvm::Value *word, llvm::Type *type,
                                    bool isCuda) {
  // A pointer parameter of a kernel points to global memory: the cast says so.
  if (type->isPointerTy() && isCuda)
    return builder.CreateAddrSpaceCast(
        builder.CreateIntToPtr(word, builder.getPtrTy(/*AddrSpace=*/1)), type);
  if (type->isPointerTy())
    return builder.CreateIntToPtr(word, type);
  unsigned bits = type->getPrimitiveSizeInBits().getFixedValue();
  llvm::Value *value = builder.CreateTrunc(word, builder.getIntNTy(bits));
  return builder.CreateBitCast(value, type);
}

/// Emits a call of a parameterless function of the device library, such as the
/// number of the thread.
llvm::Value *TileBuilder::getPlace(StringRef function) {
  llvm::Module *module = builder.GetInsertBlock()->getModule();
  auto *type = llvm::FunctionType::get(builder.getInt32Ty(), false);
  return builder.CreateCall(module->getOrInsertFunction(function, type), {});
}

void TileBuilder::emitIf(llvm::Value *condition,
                         llvm::function_ref<void()> emit) {
  llvm::Function *function = builder.GetInsertBlock()->getParent();
  auto *then = llvm::BasicBlock::Create(builder.getContext(), "", function);
  auto *after = llvm::BasicBlock::Create(builder.getContext(), "", function);
  builder.CreateCondBr(condition, then, after);
  builder.SetInsertPoint(then);
  emit();
  builder.CreateBr(after);
  builder.SetInsertPoint(after);
}

void tai::disableUnrolling(llvm::Instruction *back) {
  llvm::LLVMContext &context = back->getContext();
  auto *off = llvm::MDNode::get(
      context, llvm::MDString::get(context, "llvm.loop.unroll.disable"));
  auto *loop = llvm::MDNode::getDistinct(context, {nullptr, off});
  loop->replaceOperandWith(0, loop);
  back->setMetadata(llvm::LLVMContext::MD_loop, loop);
}

TileBuilder::TileBuilder(llvm::IRBuilder<> &builder, const TileChain &chain,
                         ArrayRef<llvm::Function *> bodies,
                         llvm::Value *overlay, unsigned threads, bool isCuda)
    : builder(builder), chain(chain), bodies(bodies), overlay(overlay),
      isCuda(isCuda), rank(chain.tile.size()), window(chain.rows.front().halo) {
  for (size_t d = 0; d < rank; ++d) {
    extents.push_back(chain.tile[d] + window.low[d] + window.high[d]);
    numCells *= extents.back();
  }
  llvm::Value *block = getPlace("tai_dev_block_id");
  hasTile = builder.CreateICmpSLT(block, number(chain.numTiles()));
  first.assign(rank, nullptr);
  llvm::Value *rest = block;
  for (size_t d = rank; d-- > 0;) {
    llvm::Value *along =
        d == 0 ? rest : builder.CreateURem(rest, number(chain.tiles[d]));
    if (d != 0)
      rest = builder.CreateUDiv(rest, number(chain.tiles[d]));
    first[d] =
        builder.CreateNSWAdd(builder.CreateNSWMul(along, number(chain.tile[d])),
                             number(chain.lower[d]));
  }
  // If there is a thread for each cell, the index expressions of the thread's
  // cell are computed once for the whole chain.
  if (isCuda && numCells <= int64_t(threads)) {
    llvm::Value *thread = getPlace("tai_dev_thread_id");
    own = getCell(thread);
    hasOwn = builder.CreateAnd(hasTile,
                               builder.CreateICmpSLT(thread, number(numCells)));
  }
}

TileBuilder::Cell TileBuilder::getCell(llvm::Value *which) {
  Cell cell;
  cell.distance.resize(rank);
  cell.index.resize(rank);
  cell.place = builder.CreateZExt(which, builder.getInt64Ty());
  llvm::Value *rest = which;
  for (size_t d = rank; d-- > 0;) {
    llvm::Value *along =
        d == 0 ? rest : builder.CreateURem(rest, number(extents[d]));
    if (d != 0)
      rest = builder.CreateUDiv(rest, number(extents[d]));
    cell.distance[d] = builder.CreateNSWSub(along, number(window.low[d]));
    llvm::Value *index = builder.CreateNSWAdd(first[d], cell.distance[d]);
    if (chain.isCyclic[d]) {
      int64_t extent = chain.upper[d];
      index = builder.CreateNSWAdd(
          index, number((window.low[d] + extent - 1) / extent * extent));
      index = builder.CreateURem(index, number(extent));
    }
    cell.index[d] = index;
  }
  return cell;
}

/// Emits a loop over the cells of the tile and `halo`, divided among the
/// block's threads. Every such loop gives a cell to the same thread.
void TileBuilder::forEachCell(const TileHalo &halo, CellEmitter emit) {
  if (own) {
    llvm::Value *condition = hasOwn;
    if (llvm::Value *within = isWithin(*own, halo))
      condition = builder.CreateAnd(condition, within);
    return emitIf(condition, [&] { emit(*own); });
  }
  llvm::LLVMContext &context = builder.getContext();
  llvm::Function *function = builder.GetInsertBlock()->getParent();
  llvm::Value *thread = getPlace("tai_dev_thread_id");
  llvm::Value *threads = getPlace("tai_dev_block_dim");
  llvm::BasicBlock *before = builder.GetInsertBlock();
  auto *head = llvm::BasicBlock::Create(context, "", function);
  auto *body = llvm::BasicBlock::Create(context, "", function);
  auto *after = llvm::BasicBlock::Create(context, "", function);
  builder.CreateBr(head);
  builder.SetInsertPoint(head);
  llvm::PHINode *at = builder.CreatePHI(builder.getInt32Ty(), 2);
  at->addIncoming(thread, before);
  builder.CreateCondBr(
      builder.CreateAnd(hasTile, builder.CreateICmpSLT(at, number(numCells))),
      body, after);
  builder.SetInsertPoint(body);
  Cell cell = getCell(at);
  if (llvm::Value *within = isWithin(cell, halo))
    emitIf(within, [&] { emit(cell); });
  else
    emit(cell);
  at->addIncoming(builder.CreateNSWAdd(at, threads), builder.GetInsertBlock());
  llvm::Instruction *back = builder.CreateBr(head);
  // The loop is not unrolled, since most threads visit few cells.
  disableUnrolling(back);
  builder.SetInsertPoint(after);
}

/// Emits a test whether `cell` is in the tile or in `halo`; null if all cells
/// of the window are.
llvm::Value *TileBuilder::isWithin(const Cell &cell, const TileHalo &halo) {
  llvm::Value *all = nullptr;
  auto add = [&](llvm::Value *condition) {
    all = all ? builder.CreateAnd(all, condition) : condition;
  };
  for (size_t d = 0; d < rank; ++d) {
    if (halo.low[d] < window.low[d])
      add(builder.CreateICmpSGE(cell.distance[d], number(-halo.low[d])));
    if (halo.high[d] < window.high[d])
      add(builder.CreateICmpSLT(cell.distance[d],
                                number(chain.tile[d] + halo.high[d])));
  }
  return all;
}

/// Emits a test whether there is an iteration of the launches at `cell`; null
/// if there is one at all cells of the window.
llvm::Value *TileBuilder::isInBox(const Cell &cell) {
  llvm::Value *all = nullptr;
  for (size_t d = 0; d < rank; ++d) {
    if (chain.isCyclic[d])
      continue;
    llvm::Value *inside = builder.CreateAnd(
        builder.CreateICmpSGE(cell.index[d], number(chain.lower[d])),
        builder.CreateICmpSLT(cell.index[d], number(chain.upper[d])));
    all = all ? builder.CreateAnd(all, inside) : inside;
  }
  return all;
}

/// Emits the address, in the overlay of the array `row`, of the cell that
/// `site` accesses in the iteration at the cell `place`. Without a site, the
/// address of the cell `place` itself.
llvm::Value *TileBuilder::getOverlay(llvm::IRBuilder<> &at, const TileRow &row,
                                     llvm::Value *base, llvm::Value *place,
                                     const TileSite *site) {
  int64_t distance = 0;
  for (size_t d = 0; d < rank; ++d)
    distance = distance * extents[d] + (site ? site->digits[d].shift : 0);
  int64_t size = row.site.access.size;
  llvm::Value *address = at.CreateGEP(
      at.getInt8Ty(), base,
      at.CreateMul(place, at.getInt64(static_cast<uint64_t>(size)), "",
                   /*HasNUW=*/true, /*HasNSW=*/true));
  return at.CreateConstGEP1_64(
      at.getInt8Ty(), address,
      static_cast<uint64_t>(row.offset + distance * size));
}

/// Emits the address in global memory, as an integer, of the cell with index 0
/// of the array `row`.
llvm::Value *TileBuilder::getOrigin(const TileRow &row,
                                    ArrayRef<llvm::Value *> slots) {
  const DeviceAccess &access = row.site.access;
  size_t firstSlot = chain.stages[row.stage].firstSlot;
  auto slot = [&](int64_t number) {
    return slots[firstSlot + static_cast<size_t>(number)];
  };
  llvm::Value *origin =
      builder.CreateAdd(slot(access.slot),
                        builder.getInt64(static_cast<uint64_t>(access.offset)));
  for (const LaunchTerm &term : access.terms) {
    llvm::Value *value = builder.CreateSExt(
        builder.CreateTrunc(
            slot(term.slot),
            builder.getIntNTy(static_cast<unsigned>(term.bits))),
        builder.getInt64Ty());
    origin = builder.CreateAdd(
        origin, builder.CreateMul(value, builder.getInt64(static_cast<uint64_t>(
                                             term.factor))));
  }
  return origin;
}

llvm::Value *TileBuilder::getMemory(const TileRow &row, llvm::Value *origin,
                                    ArrayRef<llvm::Value *> indices) {
  llvm::Value *address = origin;
  for (size_t d = 0; d < rank; ++d)
    address = builder.CreateAdd(
        address,
        builder.CreateMul(builder.CreateSExt(indices[d], builder.getInt64Ty()),
                          builder.getInt64(static_cast<uint64_t>(
                              row.site.digits[d].stride))));
  return builder.CreateIntToPtr(address,
                                builder.getPtrTy(/*AddrSpace=*/isCuda ? 1 : 0));
}

void TileBuilder::emitLoads(ArrayRef<llvm::Value *> slots) {
  SmallVector<const TileRow *> loaded;
  SmallVector<llvm::Value *> origins;
  for (const TileRow &row : chain.rows)
    if (row.isLoaded) {
      loaded.push_back(&row);
      origins.push_back(getOrigin(row, slots));
    }
  if (loaded.empty())
    return;
  forEachCell(window, [&](const Cell &cell) {
    // All loads are issued before the first use of a loaded value. Beyond the
    // array, any element is loaded, since its value is not used.
    SmallVector<llvm::Value *> values;
    for (auto [row, origin] : llvm::zip(loaded, origins)) {
      SmallVector<llvm::Value *> indices(cell.index);
      for (unsigned d = 0; d < rank; ++d)
        if (!chain.isCyclic[d]) {
          indices[d] = builder.CreateBinaryIntrinsic(llvm::Intrinsic::smax,
                                                     indices[d], number(0));
          indices[d] = builder.CreateBinaryIntrinsic(
              llvm::Intrinsic::smin, indices[d],
              number(row->site.digits[d].extent - 1));
        }
      values.push_back(builder.CreateAlignedLoad(
          getType(*row), getMemory(*row, origin, indices),
          llvm::Align(static_cast<uint64_t>(row->site.access.size))));
    }
    for (auto [row, value] : llvm::zip(loaded, values))
      builder.CreateAlignedStore(
          value, getOverlay(builder, *row, overlay, cell.place, nullptr),
          llvm::Align(static_cast<uint64_t>(row->site.access.size)));
  });
}

/// Copies the function of one iteration of a launch. The copy has two more
/// parameters, the place of the cell and the overlay, and accesses the overlay
/// at the sites whose arrays have one.
llvm::Function *TileBuilder::makeStage(const TileStage &stage) {
  llvm::Function *body = bodies[stage.part - TAI_FIRST_PART];
  SmallVector<llvm::Type *> types(body->getFunctionType()->params());
  types.push_back(builder.getInt64Ty());
  types.push_back(builder.getPtrTy());
  auto *function = llvm::Function::Create(
      llvm::FunctionType::get(builder.getVoidTy(), types, false),
      llvm::GlobalValue::InternalLinkage, body->getName() + ".stage",
      *body->getParent());
  llvm::ValueToValueMapTy map;
  for (auto [from, to] : llvm::zip_first(body->args(), function->args()))
    map[&from] = &to;
  SmallVector<llvm::ReturnInst *> returns;
  llvm::CloneFunctionInto(function, body, map,
                          llvm::CloneFunctionChangeType::LocalChangesOnly,
                          returns);
  function->addFnAttr(llvm::Attribute::AlwaysInline);
  llvm::Value *place = function->getArg(body->arg_size());
  llvm::Value *base = function->getArg(body->arg_size() + 1);
  for (llvm::Instruction &instruction :
       llvm::make_early_inc_range(llvm::instructions(*function))) {
    auto *call = dyn_cast<llvm::CallInst>(&instruction);
    if (!call || !call->getCalledFunction() ||
        call->getCalledFunction()->getName() != tileSiteFunction)
      continue;
    auto site = static_cast<size_t>(
        cast<llvm::ConstantInt>(call->getArgOperand(1))->getZExtValue());
    llvm::Value *pointer = call->getArgOperand(0);
    if (int number = stage.rows[site]; number >= 0) {
      const TileRow &row = chain.rows[static_cast<size_t>(number)];
      llvm::IRBuilder<> at(call);
      pointer = getOverlay(at, row, base, place, &stage.sites[site]);
      // A pointer into the overlay is aligned to the size of one element only.
      llvm::Align alignment(static_cast<uint64_t>(row.site.access.size));
      for (llvm::User *user : call->users()) {
        if (auto *load = dyn_cast<llvm::LoadInst>(user))
          load->setAlignment(std::min(load->getAlign(), alignment));
        else if (auto *store = dyn_cast<llvm::StoreInst>(user))
          store->setAlignment(std::min(store->getAlign(), alignment));
      }
    }
    call->replaceAllUsesWith(pointer);
    call->eraseFromParent();
  }
  return function;
}

void TileBuilder::emitStages(ArrayRef<llvm::Value *> slots) {
  // Since the last barrier: overlays that threads have changed, and overlays of
  // which threads have read cells other than their own.
  llvm::SmallDenseSet<int> changed, seen;
  for (const TileStage &stage : chain.stages) {
    bool mustMeet = false;
    llvm::SmallDenseSet<int> changes, sees;
    for (auto [site, row] : llvm::zip(stage.sites, stage.rows)) {
      if (row < 0)
        continue;
      if (site.access.kind != DeviceAccess::Read) {
        mustMeet |= seen.contains(row);
        changes.insert(row);
        continue;
      }
      bool isNear = llvm::any_of(site.digits, [](const TileSite::Digit &digit) {
        return digit.shift != 0;
      });
      if (isNear) {
        mustMeet |= changed.contains(row);
        sees.insert(row);
      }
    }
    if (mustMeet) {
      llvm::Module *module = builder.GetInsertBlock()->getModule();
      builder.CreateCall(module->getOrInsertFunction(
          "tai_dev_block_barrier",
          llvm::FunctionType::get(builder.getVoidTy(), false)));
      changed.clear();
      seen.clear();
    }
    changed.insert(changes.begin(), changes.end());
    seen.insert(sees.begin(), sees.end());
    llvm::Function *function = makeStage(stage);
    SmallVector<llvm::Value *> parameters;
    for (size_t i = 0; i < stage.numSlots; ++i)
      parameters.push_back(convertSlot(builder, slots[stage.firstSlot + i],
                                       function->getArg(i)->getType(), isCuda));
    forEachCell(stage.halo, [&](const Cell &cell) {
      auto emit = [&] {
        SmallVector<llvm::Value *> arguments(parameters);
        arguments.append(cell.index.begin(), cell.index.end());
        arguments.push_back(cell.place);
        arguments.push_back(overlay);
        builder.CreateCall(function, arguments);
      };
      if (llvm::Value *inside = isInBox(cell))
        emitIf(inside, emit);
      else
        emit();
    });
  }
}

void TileBuilder::emitStores(ArrayRef<llvm::Value *> slots) {
  TileHalo none;
  none.low.assign(rank, 0);
  none.high.assign(rank, 0);
  SmallVector<llvm::Value *> origins;
  for (const TileRow &row : chain.rows)
    origins.push_back(getOrigin(row, slots));
  forEachCell(none, [&](const Cell &cell) {
    // The last tile along a dimension may extend beyond the box.
    llvm::Value *inside = builder.getTrue();
    SmallVector<llvm::Value *> indices;
    for (unsigned d = 0; d < rank; ++d) {
      indices.push_back(builder.CreateNSWAdd(first[d], cell.distance[d]));
      inside = builder.CreateAnd(
          inside, builder.CreateICmpSLT(indices[d], number(chain.upper[d])));
    }
    emitIf(inside, [&] {
      for (auto [row, origin] : llvm::zip(chain.rows, origins)) {
        llvm::Align alignment(static_cast<uint64_t>(row.site.access.size));
        llvm::Value *value = builder.CreateAlignedLoad(
            getType(row),
            getOverlay(builder, row, overlay, cell.place, nullptr), alignment);
        builder.CreateAlignedStore(value, getMemory(row, origin, indices),
                                   alignment);
      }
    });
  });
}
